"""Designs sampled around a sensor file, and their Pareto front."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import qmc

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError, MjtactileError
from mjtactile.core.types import Array
from mjtactile.design_study.buildability import check_camera, check_parts
from mjtactile.design_study.given_hardware import ALL_FREE, GivenHardware, with_distance
from mjtactile.design_study.score import Score, score
from mjtactile.design_study.sensor_file_edit import rebuilt, scaled_lens, with_markers
from mjtactile.design_study.virtual_bench import VirtualBench

_PITCHES = ("pitch_x", "pitch_y")
# Sampled parameters with their ranges: markers per millimetre along the longer side, their radius
# over their pitch, the lens as a fraction of the longest (`made_of`), factors on the file's
# thickness and pressure (uniform in their logarithm), and the pre-stretch.
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
INTERRUPTED = "interrupted"
_TRIES = 40  # maximum number of samples per feasible design

Notify = Callable[[str], None]


@dataclass(frozen=True)
class Requirements:
    """Requirements for a design; None: no requirement.

    Attributes:
        touch: Smallest force that the sensing pipeline detects, N.
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
        for requested, have, words in (
            (self.touch, reached.touch, "touch"),
            (self.edge, reached.edge_sd, "edge"),
            (self.radius, reached.radius, "radius"),
        ):
            if requested is not None and not have <= requested * (1 + 1e-9):
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
    given: GivenHardware = ALL_FREE,
    count: int = 48,
    seed: int = 0,
    notify: Notify = lambda _: None,
) -> tuple[list[DesignCandidate], str | None]:
    """Sample designs and predict the performance of each.

    Args:
        design: Initial design, which defines frame, camera, chamber and glass.
        force: Indenting force, N.
        requirements: Requirements.
        given: Parts of the camera that stay as they are.
        count: Number of designs.
        seed: Seed of the samples, which fill their ranges evenly (Sobol).
        notify: Called with progress messages.

    Returns:
        The designs that can be built and used for sensing, with the front marked; and None, or
        "interrupted" if they are those sampled before.

    Raises:
        InputError: No design is feasible.
    """
    # as scipy 1.14 calls it; newer ones take it, too
    sequence = qmc.Sobol(len(_RANGES), seed=seed)  # pyright: ignore[reportCallIssue]
    candidates: list[DesignCandidate] = []
    refused: Counter[str] = Counter()
    stopped = None
    try:
        for _ in range(_TRIES * count):
            if len(candidates) == count:
                break
            unit = sequence.random(1)[0]
            samples = _RANGES[:, 0] + unit * np.ptp(_RANGES, axis=1)
            try:
                candidates.append(_evaluate_candidate(design, samples, force, requirements, given))
            except (InputError, MjtactileError) as error:  # infeasible to build or for sensing
                refused[str(getattr(error, "field", None) or error)] += 1
                continue
            if len(candidates) % 8 == 0:
                notify(f"{len(candidates)} of {count} designs")
    except KeyboardInterrupt:
        if not candidates:
            raise
        stopped = INTERRUPTED
    if refused:
        causes = ", ".join(f"{name} ({many})" for name, many in refused.most_common(3))
        notify(f"{refused.total()} samples were refused: {causes}")
    if not candidates:
        raise InputError(
            f"none of {_TRIES * count} sampled designs could be built and used for sensing; most "
            f"often refused: {', '.join(name for name, _ in refused.most_common(3))}",
            source=design.name,
            field="--sensor",
        )
    return with_front(candidates), stopped


def _evaluate_candidate(
    design: SensorDesign,
    values: Array,
    force: float,
    requirements: Requirements,
    given: GivenHardware,
) -> DesignCandidate:
    """Predict one design. Raises InputError or MjtactileError if it is infeasible."""
    made = rebuilt(made_of(design, values, given))
    if made.markers.count > _MAX_MARKERS or radius_px(made) < _FEWEST_PX:
        raise InputError("too many or too small", source=made.name, field="markers")
    check_parts(made)
    stand = VirtualBench(made)
    check_camera(stand)
    reached = score(made, force, stand=stand)
    if not math.isfinite(reached.force_sd):
        raise InputError("is not carried or not estimated", source=made.name, field="--force-N")
    return DesignCandidate(made, reached, tuple(requirements.missed(reached)))


def made_of(design: SensorDesign, values: Array, given: GivenHardware = ALL_FREE) -> SensorDesign:
    """Return the design for sampled parameters, rounded to what can be made.

    The third parameter is the part of the image that the markers cover. It determines the lens. A
    given lens stays, and the camera's distance follows. Lens and focus given: the markers' extent
    follows.

    Args:
        design: Initial design.
        values: Parameters (6,) in the order of `_RANGES`.
        given: Parts of the camera that stay as they are.

    Returns:
        The design, without a check that it can be built.
    """
    density, fraction, covered, thicker, higher, stretch = values.tolist()
    frame = design.frame
    membrane = design.membrane
    chamber = design.chamber
    # the outermost circle edges keep _EDGE from the frame: extent + 2 share pitch = side - 2 edge
    spans = np.array([frame.length, frame.width]) - 2 * _EDGE
    if given.lens and given.focus:
        spans = np.minimum(spans, 2 * covered * _visible_half_sizes(design))
    columns, rows = (max(3, round(1e3 * density * (span + 2 * _EDGE))) for span in spans)
    extent = tuple(
        span * (many - 1) / (many - 1 + 2 * fraction)
        for span, many in zip(spans, (columns, rows), strict=True)
    )
    membrane = replace(
        membrane,
        thickness=_rounded(math.exp(thicker) * membrane.thickness, 1e-5),
        pre_stretch=_rounded(stretch, 5e-3),
    )
    supply = _rounded(math.exp(higher) * chamber.supply_gauge, 10.0)
    chamber = replace(chamber, supply_gauge=supply)
    made = with_markers(
        replace(design, membrane=membrane, chamber=chamber), rows, columns, extent, fraction
    )
    markers = made.markers
    pitches = {name: _rounded(getattr(markers, name), 1e-5, down=True) for name in _PITCHES}
    markers = replace(markers, radius=_rounded(markers.radius, 1e-5, down=True), **pitches)
    made = replace(made, markers=markers)
    if given.lens and given.focus:
        return made
    longest = longest_lens(made)
    if given.lens:
        depth = made.camera.distance - made.apparent_glass_thickness
        distance = depth / (covered * longest) + made.apparent_glass_thickness
        return with_distance(made, _rounded(distance, 1e-4), "camera.distance_mm")
    factor = _rounded(covered * longest * made.camera.fx, 1.0, down=True) / made.camera.fx
    return scaled_lens(made, factor)


def longest_lens(design: SensorDesign) -> float:
    """Return the maximum lens factor, with all flat markers in the image."""
    markers = design.markers
    resolution = np.abs(markers.p_SM[:, :2]).max(axis=0) + markers.radius
    return float((_visible_half_sizes(design) / resolution).min())


def _visible_half_sizes(design: SensorDesign) -> Array:
    """Return the half sizes (2,), m, of the flat membrane's part in the image, centered on the
    axis."""
    camera = design.camera
    depth = camera.distance - design.apparent_glass_thickness
    center = np.array([camera.width, camera.height]) / 2
    principal = np.array([camera.cx, camera.cy]) + 0.5
    centered = 1 - np.abs(principal - center) / center
    return camera.half_view * centered * depth


def _rounded(value: float, step: float, *, down: bool = False) -> float:
    """Round a value to a multiple of a step."""
    count = value / step
    return round(step * (math.floor(count) if down else round(count)), 10)


def radius_px(design: SensorDesign) -> float:
    """Return a marker's radius on the flat membrane, px."""
    return design.camera.fx * design.markers.radius / design.camera.distance


def with_front(candidates: Sequence[DesignCandidate]) -> list[DesignCandidate]:
    """Mark the Pareto front among the designs with the fewest missed requirements. The criteria are
    force sd, edge sd and number of markers.

    Args:
        candidates: Designs.

    Returns:
        The same designs, marked.
    """
    fewest = min(len(candidate.missed) for candidate in candidates)
    costs = np.array(
        [
            (
                candidate.score.force_sd,
                _last(candidate.score.edge_sd),
                candidate.design.markers.count,
            )
            for candidate in candidates
        ]
    )
    may = np.array([len(candidate.missed) == fewest for candidate in candidates])
    marked = []
    for index, candidate in enumerate(candidates):
        as_good = (costs[may] <= costs[index]).all(axis=1)
        better = as_good & (costs[may] < costs[index]).any(axis=1)
        marked.append(replace(candidate, on_front=bool(may[index] and not better.any())))
    return marked


def best(
    candidates: Sequence[DesignCandidate],
    count: int,
    check: Callable[[SensorDesign], None] = lambda _: None,
    notify: Notify = lambda _: None,
) -> tuple[list[DesignCandidate], list[DesignCandidate]]:
    """Select designs of the front, from the best force to the best edge.

    A selected design that a check refuses is removed, and the selection is repeated.

    Args:
        candidates: Result of `sweep`.
        count: Maximum number of designs.
        check: Check of a design; it raises InputError.
        notify: Called with progress messages.

    Returns:
        Selected designs, the best force first; and the remaining candidates, with the front marked.
    """
    left = list(candidates)
    passed: set[int] = set()
    while left:
        left = with_front(left)
        front = sorted((c for c in left if c.on_front), key=lambda c: c.score.force_sd)
        picks = np.linspace(0, len(front) - 1, min(count, len(front))).round().astype(int)
        picked = [front[index] for index in np.unique(picks)]
        refused = None
        for candidate in picked:
            if id(candidate.design) in passed:
                continue
            try:
                check(candidate.design)
            except (InputError, MjtactileError) as error:
                notify(f"a design is refused: {error}")
                refused = candidate.design
                break
            passed.add(id(candidate.design))
        if refused is None:
            return picked, left
        left = [c for c in left if c.design is not refused]
    return [], []


def _last(value: float) -> float:
    return value if math.isfinite(value) else math.inf
