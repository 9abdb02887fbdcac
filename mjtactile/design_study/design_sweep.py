"""Designs sampled around a sensor file, and their Pareto front."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import qmc

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError, MjtactileError
from mjtactile.core.types import Array
from mjtactile.design_study.score import Score, score
from mjtactile.design_study.sensor_file_edit import rebuilt, scaled_lens, with_markers
from mjtactile.design_study.virtual_bench import VirtualBench

# Sampled parameters with their ranges: markers per millimetre along the longer side, their radius
# over their pitch, the lens as a fraction of the longest, factors on the file's thickness and
# pressure (uniform in their logarithm), and the pre-stretch.
_RANGES = np.array(
    [
        (0.1, 0.5),
        (0.2, 0.36),
        (0.7, 1.0),
        (math.log(0.5), math.log(2.0)),
        (math.log(0.4), math.log(3.0)),
        (1.0, 1.2),
    ]
)
_EDGE = 2.0e-3  # distance from the frame to the edges of the outermost markers, m
_FEWEST_PX = 6.0
"""px, a marker's radius on the flat membrane: smaller ones are fitted by all their pixels."""
_MAX_MARKERS = 400
_TRIES = 40  # maximum number of samples per feasible design

Say = Callable[[str], None]


@dataclass(frozen=True)
class Requirements:
    """Requirements for a design; None: no requirement.

    Attributes:
        touch: Smallest detectable force with pixel noise alone, N.
        maximum: Largest force, N.
        edge: Standard deviation of an edge's position, m.
        radius: Smallest ball with a measurable radius, m.
    """

    touch: float | None = None
    maximum: float | None = None
    edge: float | None = None
    radius: float | None = None

    def missed(self, reached: Score) -> list[str]:
        """Return the names of the requirements that a sensor does not meet."""
        missed = []
        for wanted, have, words in (
            (self.touch, reached.seen, "touch"),
            (self.edge, reached.edge_sd, "edge"),
            (self.radius, reached.radius, "radius"),
        ):
            if wanted is not None and not have <= wanted * (1 + 1e-9):
                missed.append(words)
        if self.maximum is not None and not reached.maximum >= self.maximum:
            missed.append("range")
        return missed


@dataclass(frozen=True)
class DesignCandidate:
    """Design with its predicted performance and missed requirements.

    `on_front` is True if the design is on the Pareto front. No other design that misses as few
    requirements is then better in force, edge and marker count together.
    """

    design: SensorDesign
    score: Score
    missed: tuple[str, ...]
    on_front: bool = False


def sweep(
    design: SensorDesign,
    force: float,
    requirements: Requirements,
    *,
    count: int = 48,
    seed: int = 0,
    say: Say = lambda _: None,
) -> list[DesignCandidate]:
    """Sample designs and predict the performance of each.

    Args:
        design: Initial design, which defines frame, camera, chamber and glass.
        force: Indenting force, N.
        requirements: Requirements.
        count: Number of designs.
        seed: Seed of the samples, which fill their ranges evenly (Sobol).
        say: Called with progress messages.

    Returns:
        The designs that can be built and used for sensing, with the front marked.

    Raises:
        InputError: No design is feasible.
    """
    # as scipy 1.14 calls it; newer ones take it, too
    drawn = qmc.Sobol(len(_RANGES), seed=seed)  # pyright: ignore[reportCallIssue]
    candidates: list[DesignCandidate] = []
    for _ in range(_TRIES * count):
        if len(candidates) == count:
            break
        unit = drawn.random(1)[0]
        one = _evaluate_candidate(
            design, _RANGES[:, 0] + unit * np.ptp(_RANGES, axis=1), force, requirements
        )
        if one is not None:
            candidates.append(one)
            if len(candidates) % 8 == 0:
                say(f"{len(candidates)} of {count} designs")
    if not candidates:
        raise InputError(
            f"none of {_TRIES * count} sampled designs could be built and used for sensing",
            source=design.name,
            field="--sensor",
        )
    return with_front(candidates)


def _evaluate_candidate(
    design: SensorDesign, numbers: Array, force: float, requirements: Requirements
) -> DesignCandidate | None:
    try:
        made = rebuilt(made_of(design, numbers))
        if made.markers.count > _MAX_MARKERS or radius_px(made) < _FEWEST_PX:
            return None
        reached = score(made, force, stand=VirtualBench(made))
    except (InputError, MjtactileError):  # infeasible to build or to use for sensing
        return None
    if not math.isfinite(reached.force_sd):
        return None
    return DesignCandidate(made, reached, tuple(requirements.missed(reached)))


def made_of(design: SensorDesign, numbers: Array) -> SensorDesign:
    """Return the design for sampled parameters.

    Args:
        design: Initial design.
        numbers: Parameters (6,) in the order of `_RANGES`.

    Returns:
        The design, without a check that it can be built.
    """
    density, share, lens, thicker, higher, stretch = numbers.tolist()
    frame = design.frame
    membrane = design.membrane
    chamber = design.chamber
    sides = np.array([frame.length, frame.width])
    columns, rows = (max(3, round(1e3 * density * side)) for side in sides)
    # the outermost circle edges keep _EDGE from the frame: extent + 2 share pitch = side - 2 edge
    extent = tuple(
        (side - 2 * _EDGE) * (many - 1) / (many - 1 + 2 * share)
        for side, many in zip(sides, (columns, rows), strict=True)
    )
    membrane = replace(
        membrane, thickness=math.exp(thicker) * membrane.thickness, pre_stretch=stretch
    )
    chamber = replace(chamber, supply_gauge=math.exp(higher) * chamber.supply_gauge)
    made = with_markers(
        replace(design, membrane=membrane, chamber=chamber), rows, columns, extent, share
    )
    return scaled_lens(made, lens * longest_lens(made))


def longest_lens(design: SensorDesign) -> float:
    """Return the pinhole model's maximum lens factor, with all flat markers in the image."""
    markers = design.markers
    camera = design.camera
    reach = np.abs(markers.p_SM[:, :2]).max(axis=0) + markers.radius
    depth = camera.distance - design.apparent_glass_thickness
    room = np.array(
        [
            min(camera.cx, camera.width - 1 - camera.cx) / camera.fx,
            min(camera.cy, camera.height - 1 - camera.cy) / camera.fy,
        ]
    )
    return float((room * depth / reach).min())


def radius_px(design: SensorDesign) -> float:
    """A marker's radius on the flat membrane, px."""
    return design.camera.fx * design.markers.radius / design.camera.distance


def with_front(candidates: Sequence[DesignCandidate]) -> list[DesignCandidate]:
    """Mark the Pareto front among the designs with the fewest missed requirements. The criteria are
    force sd, edge sd and number of markers.

    Args:
        candidates: Designs.

    Returns:
        The same designs, marked.
    """
    fewest = min(len(one.missed) for one in candidates)
    costs = np.array(
        [
            (one.score.force_sd, _last(one.score.edge_sd), one.design.markers.count)
            for one in candidates
        ]
    )
    may = np.array([len(one.missed) == fewest for one in candidates])
    marked = []
    for number, one in enumerate(candidates):
        as_good = (costs[may] <= costs[number]).all(axis=1)
        better = as_good & (costs[may] < costs[number]).any(axis=1)
        marked.append(replace(one, on_front=bool(may[number] and not better.any())))
    return marked


def best(candidates: Sequence[DesignCandidate], count: int) -> list[DesignCandidate]:
    """Select designs of the front, from the best force to the best edge.

    Args:
        candidates: Result of `sweep`.
        count: Maximum number of designs.

    Returns:
        Designs, the best force first.
    """
    front = sorted((one for one in candidates if one.on_front), key=lambda one: one.score.force_sd)
    picked = np.unique(np.linspace(0, len(front) - 1, min(count, len(front))).round().astype(int))
    return [front[number] for number in picked]


def _last(value: float) -> float:
    return value if math.isfinite(value) else math.inf
