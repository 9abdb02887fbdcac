"""Predicted performance of a sensor file: key figures, a map of the sensing surface, and the
benefit of changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
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

Say = Callable[[str], None]


@dataclass(frozen=True)
class Picture:
    """Use of the camera image: fractions of its width and height covered by the opening.

    `longest_lens` is the maximum factor on the focal length until a marker leaves the image, flat
    or inflated.
    """

    width_used: float
    height_used: float
    longest_lens: float


@dataclass(frozen=True)
class Change:
    """Effect of a change of the sensor file: its description `what`, and the score after it. None:
    it cannot be built, or cannot be used for sensing."""

    what: str
    score: Score | None
    why_not: str = ""


@dataclass(frozen=True)
class PredictionReport:
    """Predicted performance of a sensor file.

    It holds the `score` for an indenting `force`, N, and the map of its face. It also holds its
    image and the effects of changes to the file.
    """

    design: SensorDesign
    force: float
    score: Score
    face: tuple[Resolution, ...]
    picture: Picture
    changes: tuple[Change, ...]


def study(design: SensorDesign, force: float, *, say: Say = lambda _: None) -> PredictionReport:
    """Predict the performance of a sensor file.

    Args:
        design: The sensor.
        force: Indenting force, N.
        say: Called with progress messages.

    Returns:
        The study.

    Raises:
        InputError: The membrane has no equilibrium, or markers are outside of the image.
    """
    stand = VirtualBench(design)
    say("predicting the performance")
    own = score(design, force, stand=stand)
    reacher = ResolutionPredictor(stand)
    places = face_places(design)
    face = []
    for number, place in enumerate(places):
        if number % 10 == 0:
            say(f"sensing surface: {number} of {len(places)} positions")
        face.append(reacher.at(place, force))
    picture = picture_of(stand)
    changes = []
    for what, changed in variants(design, picture.longest_lens):
        say(f"effect of a change: {what}")
        changes.append(_changed(what, changed, force))
    return PredictionReport(design, force, own, tuple(face), picture, tuple(changes))


def face_places(design: SensorDesign) -> list[Array]:
    """Return the positions of the map, (2,) m each, row by row, in the rectangle around the
    opening."""
    lines = []
    for side in (design.frame.length, design.frame.width):
        half = max(side / 2 - _MARGIN, 0.0)
        lines.append(np.linspace(-half, half, max(3, 2 * round(half / _SPACING) + 1)))
    return [np.array([x, y]) for y in lines[1] for x in lines[0]]


def picture_of(stand: VirtualBench) -> Picture:
    """Evaluate the use of the camera image.

    Args:
        stand: The sensor.

    Returns:
        Fractions of width and height, and the longest lens.
    """
    design = stand.design
    camera = Camera.from_design(design.camera, design.glass)
    sides = np.array([design.frame.length, design.frame.width]) / 2
    corners = sides * [[-1, -1], [-1, 1], [1, -1], [1, 1]]
    middles = sides * [[-1, 0], [1, 0], [0, -1], [0, 1]]
    outline = design.frame.outline
    rim = np.concatenate([corners, middles]) if outline is None else outline.points(_RIM)
    p_SP = np.pad(rim, ((0, 0), (0, 1)))
    uv = project(camera, p_SP - design.camera.p_SC)
    size = np.array([design.camera.width, design.camera.height])
    inside = np.clip(uv, -0.5, size - 0.5)
    used = np.ptp(inside, axis=0) / size
    return Picture(float(used[0]), float(used[1]), _longest_lens(stand))


def _longest_lens(stand: VirtualBench) -> float:
    flat = np.zeros_like(stand.film.rest.x)
    low = 1.0
    high = _LONGEST
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        sighter = EllipseSampler(scaled_lens(stand.design, middle))
        seen = [
            sighter.sight(*stand.poses(x), errors=False).ellipses for x in (flat, stand.film.rest.x)
        ]
        whole = all(one is not None and len(one) == stand.circles for one in seen)
        low, high = (middle, high) if whole else (low, middle)
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
        (
            f"focal length {lens * camera.fx:.0f} px ({_percent(lens)}, the maximum for the image)"
            if lens < _MORE
            else f"focal length {lens * camera.fx:.0f} px (a quarter more)",
            scaled_lens(design, lens),
        ),
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


def _changed(what: str, design: SensorDesign, force: float) -> Change:
    try:
        return Change(what, score(rebuilt(design), force))
    except (InputError, MjtactileError) as error:
        return Change(what, None, str(error))


def _percent(factor: float) -> str:
    return f"{100 * (factor - 1):+.0f} %"


def as_table(given: PredictionReport) -> dict[str, Any]:
    """The study as `mjtactile design --json` has it, lengths in mm, forces in N and mN.

    Args:
        given: The study.

    Returns:
        The JSON's object.
    """
    return {
        "sensor": given.design.name,
        "force_N": given.force,
        "reaches": given.score.table(),
        "picture": {
            "width_used": given.picture.width_used,
            "height_used": given.picture.height_used,
            "longest_lens": given.picture.longest_lens,
        },
        "face": [
            {
                "x_mm": 1e3 * one.x,
                "y_mm": 1e3 * one.y,
                "felt_N": one.felt,
                "force_sd_mN": 1e3 * one.force_sd,
                "force_noise_mN": 1e3 * one.noise,
                "place_sd_mm": 1e3 * one.place_sd,
                "edge_sd_mm": 1e3 * one.edge_sd,
            }
            for one in given.face
        ],
        "changes": [
            {
                "what": one.what,
                "reaches": None if one.score is None else one.score.table(),
                "why_not": one.why_not,
            }
            for one in given.changes
        ],
    }
