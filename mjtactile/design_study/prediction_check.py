"""What was predicted beside full simulation: a ball pressed at fresh places and depths, felt from
drawn images."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.design_study.resolution import BALL_RADIUS, ResolutionPredictor
from mjtactile.design_study.virtual_bench import VirtualBench
from mjtactile.experiments.indentation import IndentationPlan, press
from mjtactile.sim.scenes.indentation import Indenter

_SPACING = 1.7e-3  # m between the sheet's vertices: a coarser mesh is stiffer than rubber
_SAME = 1e-9  # m
_MARGIN = 6e-3  # m from the frame, in which no ball presses
_DEPTHS = (0.8e-3, 3.2e-3)  # m, between which it does


@dataclass(frozen=True)
class Checked:
    """One press: `place` m, `depth` m; true and felt force, N; how far, m, the place where the
    force acts is off along x and y; and the sd that was predicted of both, and what the chain
    itself said of the force."""

    place: tuple[float, float]
    depth: float
    true: float
    felt: float
    off: tuple[float, float]
    force_sd: float
    place_sd: float
    reported_sd: float


@dataclass(frozen=True)
class PredictionCheck:
    """Ratios of measured scatter to what was predicted, over `count` presses: the root mean square
    of error over predicted sd, of force and of place; and the measured root mean square errors, N
    and m. `reported_ratio` is that of the chain's own sd of each press."""

    count: int
    force_ratio: float
    place_ratio: float
    reported_ratio: float
    force_rms: float
    place_rms: float


def check(
    design: SensorDesign,
    *,
    places: int = 6,
    depths: int = 3,
    seed: int = 0,
    say: Callable[[str], None] = lambda _: None,
) -> list[Checked]:
    """Press a ball into the simulated sensor at random places, each to random depths.

    Args:
        design: The sensor.
        places: How many.
        depths: How many at each.
        seed: Of places, depths and the camera's noise.
        say: Told after each place.

    Returns:
        The presses that were felt and could be predicted.
    """
    rng = np.random.default_rng(seed)
    reacher = ResolutionPredictor(VirtualBench(design))
    sides = np.array([design.frame.length, design.frame.width]) / 2 - _MARGIN
    mesh = mesh_of(design)
    found = []
    for number in range(places):
        at = rng.uniform(-sides, sides)
        while design.frame.inside(at[None])[0] < _MARGIN - _SAME:
            at = rng.uniform(-sides, sides)
        into = np.sort(rng.uniform(*_DEPTHS, depths))
        plan = IndentationPlan(
            Indenter("sphere", BALL_RADIUS), into.tolist(), (float(at[0]), float(at[1]))
        )
        result = press(design, plan, mesh=mesh, seed=int(rng.integers(2**31)))
        found += [
            one for step in result["steps"] if (one := _compared(reacher, at, step)) is not None
        ]
        say(f"place {number + 1} of {places}: {len(found)} presses")
    return found


def mesh_of(design: SensorDesign) -> tuple[int, int]:
    """Vertices along x and y, fine enough for what is checked."""
    sides = (design.frame.length, design.frame.width)
    columns, rows = (2 * math.ceil(side / _SPACING / 2) + 1 for side in sides)
    return columns, rows


def _compared(reacher: ResolutionPredictor, at: np.ndarray, step: dict) -> Checked | None:
    true = -float(step["force_true_N"][2])
    wrench = step["wrench_estimated"]
    reach = reacher.at(at, true, edges=False)
    if str(step["status"]) != "ok" or not math.isfinite(reach.force_sd):
        return None
    moments = [reach.height * wrench[0] - wrench[4], reach.height * wrench[1] + wrench[3]]
    off = np.array(moments) / wrench[2] - at
    return Checked(
        (float(at[0]), float(at[1])),
        1e-3 * step["depth_mm"],
        true,
        -float(wrench[2]),
        (float(off[0]), float(off[1])),
        reach.force_sd,
        reach.place_sd,
        float(step["force_estimated_sd_N"]),
    )


def verdict(presses: list[Checked]) -> PredictionCheck:
    """Measured scatter over what was predicted.

    Args:
        presses: Of `check`; at least one.

    Returns:
        The ratios.
    """
    error = np.array([one.felt - one.true for one in presses])
    off = np.array([one.off for one in presses])
    force_sd, place_sd, said = (
        np.array([getattr(one, name) for one in presses])
        for name in ("force_sd", "place_sd", "reported_sd")
    )
    return PredictionCheck(
        len(presses),
        _rms(error / force_sd),
        _rms(off / place_sd[:, None]),
        _rms(error / said),
        _rms(error),
        _rms(off),
    )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
