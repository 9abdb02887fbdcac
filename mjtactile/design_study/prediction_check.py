"""Comparison of predictions with full simulation: a ball at random positions and depths."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.design_study.resolution import BALL_RADIUS, ResolutionPredictor, ball
from mjtactile.design_study.score import MAX_FORCE_ERROR, RANGE_RADIUS, rms
from mjtactile.design_study.virtual_bench import VirtualBench
from mjtactile.experiments.indentation import IndentationPlan, press
from mjtactile.sim.scenes.indentation import Indenter

_SPACING = 1.7e-3  # spacing of the membrane's vertices, m; a coarser mesh is stiffer than rubber
_SAME = 1e-9  # length tolerance, m
_MARGIN = 6e-3  # minimum distance of the ball from the frame, m
# tested depths, as fractions of the depth at the predicted maximum force
_RANGE_STEPS = (0.4, 0.7, 0.9, 1.0, 1.05)
_CONFIRMED_FRACTION = 0.9  # fraction of the predicted maximum force that counts as reached
_DEPTHS = (0.8e-3, 3.2e-3)  # range of the indentation depth, m


@dataclass(frozen=True)
class Checked:
    """One indentation at `place` m with `depth` m.

    It holds the ground truth and the estimated force, N. `off` is the error of the force's position
    along x and y, m. The predicted sd of both and the sd of the force reported by the sensing
    pipeline follow.
    """

    place: tuple[float, float]
    depth: float
    true: float
    estimated: float
    off: tuple[float, float]
    force_sd: float
    position_sd: float
    reported_sd: float


@dataclass(frozen=True)
class PredictionCheck:
    """Ratios of measured to predicted scatter over `count` indentations.

    Each ratio is the root mean square of error over predicted sd, for force and position.
    `force_rms` and `place_rms` are the root mean square errors, N and m. `reported_ratio` refers to
    the sensing pipeline's own sd of each indentation.
    """

    count: int
    force_ratio: float
    place_ratio: float
    reported_ratio: float
    force_rms: float
    place_rms: float


def check(
    design: SensorDesign,
    *,
    positions: int = 6,
    depths: int = 3,
    seed: int = 0,
    notify: Callable[[str], None] = lambda _: None,
) -> list[Checked]:
    """Indent the simulated sensor with a ball at random positions and depths.

    Args:
        design: The sensor.
        positions: Number of positions.
        depths: Number of depths at each position.
        seed: Seed of positions, depths and camera noise.
        notify: Called after each position.

    Returns:
        The indentations with a valid estimate and prediction.
    """
    rng = np.random.default_rng(seed)
    predictor = ResolutionPredictor(VirtualBench(design))
    sides = np.array([design.frame.length, design.frame.width]) / 2 - _MARGIN
    mesh = mesh_of(design)
    found = []
    for index in range(positions):
        at = rng.uniform(-sides, sides)
        while design.frame.inside(at[None])[0] < _MARGIN - _SAME:
            at = rng.uniform(-sides, sides)
        steps = np.sort(rng.uniform(*_DEPTHS, depths)).tolist()
        plan = IndentationPlan(Indenter("sphere", BALL_RADIUS), steps, (float(at[0]), float(at[1])))
        result = press(design, plan, mesh=mesh, seed=int(rng.integers(2**31)))
        compared = [_compared(predictor, at, step) for step in result["steps"]]
        found += [item for item in compared if item is not None]
        notify(f"position {index + 1} of {positions}: {len(found)} indentations")
    return found


@dataclass(frozen=True)
class RangeCheck:
    """Check of a predicted maximum force by indentations.

    `confirmed` is the largest simulated force, N, up to which all estimates are within the error
    limit of the maximum force. `forces` and `estimates` are the indentations', N.
    """

    claimed: float
    confirmed: float
    forces: tuple[float, ...]
    estimates: tuple[float, ...]

    @property
    def is_confirmed(self) -> bool:
        """True if the indentations reach the predicted maximum."""
        return self.confirmed >= _CONFIRMED_FRACTION * self.claimed


def check_range(design: SensorDesign, claimed: float, *, seed: int = 0) -> RangeCheck:
    """Indent the simulated sensor with the ball of the maximum force, up to the predicted maximum.

    Args:
        design: The sensor.
        claimed: Predicted maximum force, N.
        seed: Seed of camera noise.

    Returns:
        The forces, and the range that they confirm.
    """
    stand = VirtualBench(design)
    shape = ball(np.zeros(2), RANGE_RADIUS)
    pressed = stand.press(shape, claimed)
    if pressed is None:
        return RangeCheck(claimed, 0.0, (), ())
    depth = stand.first_touch(shape) - pressed.height
    plan = IndentationPlan(
        Indenter("sphere", RANGE_RADIUS), [depth * part for part in _RANGE_STEPS]
    )
    steps = press(design, plan, mesh=mesh_of(design), seed=seed)["steps"]
    forces = [-float(step["force_true_N"][2]) for step in steps]
    estimates = [
        -float(step["wrench_estimated"][2]) if str(step["status"]) == "ok" else math.nan
        for step in steps
    ]
    confirmed = 0.0
    for force, estimate in zip(forces, estimates, strict=True):
        if not abs(estimate - force) <= MAX_FORCE_ERROR * force:
            break
        confirmed = force
    return RangeCheck(claimed, confirmed, tuple(forces), tuple(estimates))


def mesh_of(design: SensorDesign) -> tuple[int, int]:
    """Return the numbers of vertices along x and y that are sufficient for the check."""
    sides = (design.frame.length, design.frame.width)
    columns, rows = (2 * math.ceil(side / _SPACING / 2) + 1 for side in sides)
    return columns, rows


def _compared(predictor: ResolutionPredictor, at: np.ndarray, step: dict) -> Checked | None:
    true = -float(step["force_true_N"][2])
    wrench = step["wrench_estimated"]
    predicted = predictor.at(at, true, edges=False)
    if str(step["status"]) != "ok" or not math.isfinite(predicted.force_sd):
        return None
    moments = [predicted.height * wrench[0] - wrench[4], predicted.height * wrench[1] + wrench[3]]
    center_error = np.array(moments) / wrench[2] - at
    return Checked(
        (float(at[0]), float(at[1])),
        1e-3 * step["depth_mm"],
        true,
        -float(wrench[2]),
        (float(center_error[0]), float(center_error[1])),
        predicted.force_sd,
        predicted.position_sd,
        float(step["force_estimated_sd_N"]),
    )


def verdict(presses: list[Checked]) -> PredictionCheck:
    """Compute the ratios of measured to predicted scatter.

    Args:
        presses: Result of `check`; at least one.

    Returns:
        The ratios.
    """
    error = np.array([press.estimated - press.true for press in presses])
    center_errors = np.array([press.off for press in presses])
    force_sd, position_sd, reported = (
        np.array([getattr(press, name) for press in presses])
        for name in ("force_sd", "position_sd", "reported_sd")
    )
    return PredictionCheck(
        len(presses),
        rms(error / force_sd),
        rms(center_errors / position_sd[:, None]),
        rms(error / reported),
        rms(error),
        rms(center_errors),
    )
