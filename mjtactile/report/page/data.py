"""Data of a run's page for its scripts: curves over time, images and membranes at selected
times."""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, Image, Touch
from mjtactile.recording.log_schema import Seen
from mjtactile.recording.reader import Recording
from mjtactile.report.html import data_uri
from mjtactile.report.overlay import with_ellipses
from mjtactile.report.shape_wireframe import describe_shape, lines_of, true_lines
from mjtactile.report.software_renderer import render_view
from mjtactile.report.summary_figure import FINGER_COLOURS, PHASE_COLOURS, arrow_unit, arrows

# Width of a camera image; height and width of the scene image, px
_CAMERA = 480
_SCENE = (405, 270)
_IMAGES_MAX = 96  # maximum number of camera images: 20 kB each
_JPEG = (cv2.IMWRITE_JPEG_QUALITY, 70)
_GREY = "#555555"


@dataclass(frozen=True)
class Plot:
    """Curve of each finger, or a single one.

    It shows a `column` of the recording, multiplied by `scale`. `sd` is the column of its standard
    deviation, `true` its ground truth.
    """

    label: str
    column: str
    scale: float = 1.0
    sd: str = ""
    true: Callable[[Recording], Array] | None = None


PLOTS = (
    Plot(
        "normal force per finger, N",
        "force_normal",
        sd="force_normal_sd",
        true=lambda r: r.column("force_normal_true"),
    ),
    Plot(
        "shear force per finger, N",
        "force_shear",
        true=lambda r: np.linalg.norm(_wrench_true(r)[..., :2], axis=-1),
    ),
    Plot("contact area, mm\u00b2", "contact_area", 1e6),
    Plot("maximum indentation depth, mm", "contact_depth", 1e3),
    Plot("slip since the start of the contact, mm", "slip_distance", 1e3),
    Plot("gauge pressure of the chamber, kPa", "gauge_pressure", 1e-3),
    Plot("markers found", "marker_count"),
    Plot("opening of the jaws, mm", "opening", 1e3),
    Plot("height of the gripper, mm", "lift_height", 1e3),
    Plot("perception, ms per cycle", "perception_ms"),
)


def _wrench_true(recording: Recording) -> Array:
    found = recording.column("wrench_true")
    return found if found.ndim == 3 else np.full((len(recording), recording.width, 6), np.nan)


def page_data(
    recording: Recording, strip: Sequence[tuple[Seen, Any]], snapshot: Seen | None = None
) -> dict[str, Any]:
    """Return the scripts' data; `strip`: cycles with scenes, `snapshot`: the first shown."""
    every = math.ceil(len(strip) * recording.width / _IMAGES_MAX) or 1
    moments = strip[::every]
    touches = [touch for cycle, _ in moments for touch in cycle.touch]
    low, high = _heights(touches)
    unit = height_unit(low, high)
    times = recording.column("time")[:, 0]
    shown = -1 if snapshot is None else snapshot.time
    # nearly all of it is in C, which releases the interpreter
    with ThreadPoolExecutor(2) as pool:
        shots = list(pool.map(lambda moment: _shot(moment[0], moment[1], unit), moments))
    phases = [
        (*phase, PHASE_COLOURS.get(phase[0], "#eeeeee"))
        for phase in recording.phases()
        if phase[0] != "done"
    ]
    plots = [_plot(plot, recording) for plot in PLOTS]
    return {
        "fingers": recording.fingers,
        "time": _plain(times, 4),
        "phase": [str(name) for name in recording.columns["phase"]],
        "phases": phases,
        "touch_texts": _touch_texts(recording),
        "plots": [plot for plot in plots if plot["series"]],
        "grids": _grids(moments, recording.width),
        "z_range": (1e3 * low, 1e3 * high),
        "height_unit": unit,
        "arrow_unit": arrow_unit(touches),
        "shots": shots,
        "first": _nearest(moments, shown),
    }


def _nearest(moments: Sequence[Any], time: float) -> int:
    """Return the index of the cycle closest to `time`, s."""
    if not moments:
        return 0
    return int(np.argmin([abs(cycle.time - time) for cycle, _ in moments]))


def height_unit(low: float, high: float) -> float:
    """Return the height of one step of the 16-bit encoding, mm."""
    return 1e3 * max(abs(low), abs(high), 1e-4) / 32000


def _heights(touches: Sequence[Touch]) -> tuple[float, float]:
    """Return the minimum and maximum height of all membranes, m."""
    heights = [touch.surface.z for touch in touches if touch.surface is not None]
    low = min((float(z.min()) for z in heights), default=0.0)
    high = max((float(z.max()) for z in heights), default=1e-3)
    return low, high


def _plot(plot: Plot, recording: Recording) -> dict[str, Any]:
    """Return the curves of a plot; unknown series are omitted.

    Format: `{"label", "series": [{"name", "colour", "y", "sd", "dash"}], "lines": [(value,
    words)]}`.
    """
    estimated = plot.scale * recording.column(plot.column)
    sd = recording.column(plot.sd) if plot.sd else None
    true = None if plot.true is None else plot.scale * plot.true(recording)
    single = estimated.shape[1] == 1 and recording.width != 1
    series: list[dict[str, Any]] = []
    for finger in range(estimated.shape[1]):
        colour = _GREY if single else FINGER_COLOURS[finger % len(FINGER_COLOURS)]
        if single:
            name = plot.label.split(",")[0]
        else:
            name = dict(enumerate(recording.fingers)).get(finger, "")
        own_sd = None if sd is None else sd[:, finger]
        if true is None:
            series += _series(name, colour, estimated[:, finger], own_sd)
        else:
            series += _series(f"{name} estimated", colour, estimated[:, finger], own_sd)
            series += _series(f"{name} ground truth", colour, true[:, finger], dash=True)
    breaks = recording.notes.get("break_force_N")
    lines = []
    if plot.sd and isinstance(breaks, (int, float)):
        lines = [(breaks, f"object breaks at {breaks:g} N")]
    return {"label": plot.label, "series": series, "lines": lines}


def _series(
    name: str, colour: str, y: Array, sd: Array | None = None, *, dash: bool = False
) -> list[dict[str, Any]]:
    if not np.isfinite(y).any():
        return []
    band = None if sd is None else _plain(sd, 5)
    return [{"name": name, "colour": colour, "y": _plain(y, 5), "sd": band, "dash": dash}]


def _plain(values: Array, digits: int) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in np.round(values, digits).tolist()]


def _touch_texts(recording: Recording) -> list[list[str]]:
    """Return the slip state of each finger in each cycle, or the reason why it is unknown."""
    statuses = recording.columns["status"]
    slips = recording.columns.get("slip_state", statuses)
    reported = []
    for slip, status in zip(slips, statuses, strict=True):
        pairs = zip(slip, status, strict=True)  # finger by finger
        reported.append([str(state if why == "ok" else why) for state, why in pairs])
    return reported


def _grids(
    moments: Sequence[tuple[Seen, Any]], fingers: int
) -> list[dict[str, list[float]] | None]:
    """Return the grid coordinates of each finger's height map, mm."""
    found: list[dict[str, list[float]] | None] = [None] * fingers
    for cycle, _ in moments:
        for finger, touch in enumerate(cycle.touch[:fingers]):
            if touch.surface is not None:
                found[finger] = {
                    "x": (1e3 * touch.surface.x).round(4).tolist(),
                    "y": (1e3 * touch.surface.y).round(4).tolist(),
                }
    return found


def _shot(cycle: Seen, view: Any, unit: float) -> dict[str, Any]:
    """Return images, scene and membranes at one time."""
    scene = None
    if view is not None:
        bgr = render_view(view, _SCENE, samples=1)[:, :, ::-1]
        scene = _jpeg(np.round(255 * bgr).astype(np.uint8))
    return {
        "time": round(cycle.time, 4),
        "pictures": [_camera(image) for image in cycle.images],
        "scene": scene,
        "estimates": [_estimated(touch, unit, view, k) for k, touch in enumerate(cycle.touch)],
    }


def _camera(image: Image) -> str | None:
    if image.pixels.size:
        return _jpeg(with_ellipses(image, min(_CAMERA, image.pixels.shape[1])))
    return None


def _jpeg(bgr: NDArray[np.uint8]) -> str:
    return data_uri("image/jpeg", cv2.imencode(".jpg", bgr, _JPEG)[1].tobytes())


def _estimated(touch: Touch, unit: float, view: Any, finger: int) -> Mapping[str, Any] | None:
    """Return the estimated membrane of a finger.

    `z` (ny nx) holds integers in units of `unit` mm. Each arrow has its foot, mm, and the negative
    traction, Pa. Further entries are the lines of the estimated contact shape and of the ground
    truth, mm.
    """
    if touch.surface is None:
        return None
    foot, stress = arrows(touch, touch.surface)
    z = np.round(1e3 * touch.surface.z / unit).astype("<i2")
    if touch.status == "ok":
        reported = f"{touch.force_normal:.2f} \u00b1 {2 * touch.force_normal_sd:.2f} N"
    else:
        reported = f"force unknown: {touch.status}"
    shape = touch.shape
    if shape is not None:
        reported += f"; {describe_shape(shape)}"
    estimated_lines = [] if shape is None else lines_of(shape)
    true = [] if shape is None or view is None else true_lines(shape, view, finger)
    return {
        "z": base64.b64encode(z.tobytes()).decode("ascii"),
        "shape": [(1e3 * line).round(2).tolist() for line in estimated_lines],
        "true": [(1e3 * item).round(2).tolist() for item in true],
        "arrows": np.column_stack([foot.round(2), -stress.round(0)]).tolist(),
        "text": reported,
    }
