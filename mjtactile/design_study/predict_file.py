"""Predicted performance of a sensor file: key figures, a map, and the benefit of changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError, MjtactileError
from mjtactile.core.optics import Camera, project
from mjtactile.core.types import Array
from mjtactile.design_study.resolution import Resolution, ResolutionPredictor
from mjtactile.design_study.score import Score, score
from mjtactile.design_study.sensor_file_edit import (
    extent_of,
    radius_fraction,
    rebuilt,
    scaled_lens,
    scaled_pixels,
    with_markers,
)
from mjtactile.design_study.virtual_bench import VirtualBench
from mjtactile.sim.rendering.synthetic_ellipses import EllipseSampler

_MARGIN = 5e-3  # distance from the frame to the outermost positions of the map, m
_SPACING = 5e-3  # approximate spacing of the positions, m
_LONGEST = 3.0  # maximum factor of the focal length in the search
_HALVINGS = 12
_RIM = 72  # number of points on an outline
_MORE = 1.25

Notify = Callable[[str], None]


@dataclass(frozen=True)
class ImageUse:
    """Fractions of the image that the opening covers, and the maximum lens factor."""

    width_used: float
    height_used: float
    longest_lens: float


@dataclass(frozen=True)
class Change:
    """Change of a file and its score; None: it cannot be built or used, for `why_not`."""

    change: str
    score: Score | None
    why_not: str = ""


@dataclass(frozen=True)
class PredictionReport:
    """Predicted score at a `force`, N, map of the face, image use, effects of changes."""

    design: SensorDesign
    force: float
    score: Score
    face: tuple[Resolution, ...]
    image_use: ImageUse
    changes: tuple[Change, ...]


def study(
    design: SensorDesign, force: float, *, notify: Notify = lambda _: None
) -> PredictionReport:
    """Predict the performance of a sensor file.

    Args:
        design: The sensor.
        force: Indenting force, N.
        notify: Called with progress messages.

    Returns:
        The study.

    Raises:
        InputError: The membrane has no equilibrium, or markers are outside of the image.
    """
    stand = VirtualBench(design)
    notify("predicting the performance")
    unchanged = score(design, force, stand=stand)
    predictor = ResolutionPredictor(stand)
    positions = face_positions(design)
    face = []
    for index, position in enumerate(positions):
        if index % 10 == 0:
            notify(f"sensing surface: {index} of {len(positions)} positions")
        face.append(predictor.at(position, force))
    image_use = image_use_of(stand)
    changes = []
    for label, variant in variants(design, image_use.longest_lens):
        notify(f"effect of a change: {label}")
        try:
            changes.append(Change(label, score(rebuilt(variant), force)))
        except (InputError, MjtactileError) as error:
            changes.append(Change(label, None, str(error)))
    return PredictionReport(design, force, unchanged, tuple(face), image_use, tuple(changes))


def face_positions(design: SensorDesign) -> list[Array]:
    """Return the map's positions (2,) m, row by row, in the rectangle around the opening."""
    lines = []
    for side in (design.frame.length, design.frame.width):
        half = max(side / 2 - _MARGIN, 0.0)
        lines.append(np.linspace(-half, half, max(3, 2 * round(half / _SPACING) + 1)))
    return [np.array([x, y]) for y in lines[1] for x in lines[0]]


def image_use_of(stand: VirtualBench) -> ImageUse:
    """Evaluate the use of the camera image."""
    design = stand.design
    camera = Camera.from_design(design.camera, design.glass)
    sides = np.array([design.frame.length, design.frame.width]) / 2
    corners = sides * [[-1, -1], [-1, 1], [1, -1], [1, 1]]
    midpoints = sides * [[-1, 0], [1, 0], [0, -1], [0, 1]]
    outline = design.frame.outline
    rim = np.concatenate([corners, midpoints]) if outline is None else outline.points(_RIM)
    p_SP = np.pad(rim, ((0, 0), (0, 1)))
    uv = project(camera, p_SP - design.camera.p_SC)
    size = np.array([design.camera.width, design.camera.height])
    inside = np.clip(uv, -0.5, size - 0.5)
    used = np.ptp(inside, axis=0) / size
    return ImageUse(float(used[0]), float(used[1]), _longest_lens(stand))


def _longest_lens(stand: VirtualBench) -> float:
    flat = np.zeros_like(stand.membrane.rest.x)
    low = 1.0
    high = _LONGEST
    for _ in range(_HALVINGS):
        midpoint = (low + high) / 2
        sampler = EllipseSampler(scaled_lens(stand.design, midpoint))
        views = [
            sampler.sample(*stand.poses(x), errors=False).ellipses
            for x in (flat, stand.membrane.rest.x)
        ]
        is_complete = all(view is not None and len(view) == stand.circles for view in views)
        low, high = (midpoint, high) if is_complete else (low, midpoint)
    return low


def variants(design: SensorDesign, longest_lens: float) -> list[tuple[str, SensorDesign]]:
    """Return modified sensors with one change each, with a description.

    Args:
        design: The sensor.
        longest_lens: Maximum factor of the focal length that the image allows.

    Returns:
        Description and sensor of each.
    """
    chamber = design.chamber
    membrane = design.membrane
    camera = design.camera
    markers = design.markers
    rows, columns = (round(_MORE * count) for count in (markers.rows, markers.columns))
    lens = min(_MORE, longest_lens)
    longer = "a quarter more"
    if lens < _MORE:
        longer = f"{100 * (lens - 1):+.0f} %, the maximum for the image"
    stretch = membrane.pre_stretch + 0.05
    return [
        (
            f"pressure {1e-3 * _MORE * chamber.supply_gauge:.3g} kPa (a quarter more)",
            replace(design, chamber=replace(chamber, supply_gauge=_MORE * chamber.supply_gauge)),
        ),
        (
            f"{columns} x {rows} markers (a quarter more each way, and as much smaller)",
            with_markers(design, rows, columns, extent_of(design), radius_fraction(design)),
        ),
        (f"focal length {lens * camera.fx:.0f} px ({longer})", scaled_lens(design, lens)),
        (
            f"{round(_MORE * camera.width)} x {round(_MORE * camera.height)} pixels of the same "
            "view (a quarter more each way)",
            scaled_pixels(design, _MORE),
        ),
        (
            f"pixel noise {camera.noise_dn / 2:g} DN (half: the mean of four images)",
            replace(design, camera=replace(camera, noise_dn=camera.noise_dn / 2)),
        ),
        (
            f"a membrane of {1e3 * membrane.thickness / _MORE:.2f} mm (a fifth less)",
            replace(design, membrane=replace(membrane, thickness=membrane.thickness / _MORE)),
        ),
        (
            f"pre-stretch {stretch:.2f} (0.05 more)",
            replace(design, membrane=replace(membrane, pre_stretch=stretch)),
        ),
    ]


def as_table(given: PredictionReport) -> dict[str, Any]:
    """Return the JSON object of `mjtactile design --json`; lengths in mm, forces in N and mN."""
    changes = [
        asdict(change) | {"performance": None if change.score is None else change.score.table()}
        for change in given.changes
    ]
    return {
        "sensor": given.design.name,
        "force_N": given.force,
        "performance": given.score.table(),
        "image": asdict(given.image_use),
        "face": [
            {
                "x_mm": 1e3 * at.x,
                "y_mm": 1e3 * at.y,
                "estimated_N": at.estimated,
                "force_sd_mN": 1e3 * at.force_sd,
                "force_noise_mN": 1e3 * at.noise,
                "position_sd_mm": 1e3 * at.position_sd,
                "edge_sd_mm": 1e3 * at.edge_sd,
            }
            for at in given.face
        ],
        "changes": [
            {key: own[key] for key in ("change", "performance", "why_not")} for own in changes
        ],
    }
