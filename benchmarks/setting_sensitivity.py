"""`mjtactile bench setting-sensitivity`: effect of halving and doubling the sensing pipeline's
tuned parameters.

The same images are evaluated with each value. Derived parameters, and those fitted by another
benchmark, are excluded.

Touch: loads, drags and lifts of a ball on both shipped layouts. They are recorded once, with their
references, so that a change is due to the setting alone. Images for `locate`: sharp, black and
white, half in glare, small, from a camera with a gamma, blurred and noisy.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.config_fields import entries
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import MjtactileError
from mjtactile.core.optics import Camera
from mjtactile.core.types import Array, Image, Touch
from mjtactile.experiments.test_bench import View
from mjtactile.recording.files import write_json
from mjtactile.runtime.progress import Progress
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sensing.pose.circles_from_images import detect_circles
from mjtactile.sensing.settings import DEFAULTS, Settings
from mjtactile.sensing.settings.tunable_parameter import TRIED
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

FACTORS = (0.5, 2.0)
RENDER_STAGES = (
    "locate",
    "neighbor_smoothing",
    "smoothness",
    "pose_disambiguation",
    "exhaustive_detection",
    "gamma",
)
"""Stages used for photographs only; the image stages are tested on both."""
IMAGE_STAGES = ("candidates", "markers", "edges", "profiles")
PRESSES = (("dense", "sphere:8", (3e-3, -2e-3), 0.0), ("paper16", "sphere:12", (1e-3, 2e-3), 0.0))
"""Sensor, indenter, position, m, and tilt, rad."""
DEPTHS = (-2e-4, 3e-4, 8e-4, 1.5e-3, 2e-3)  # depths of the load, m
SHEAR = 1.5e-3  # shear displacement, m
INTERVAL = 1 / 30  # image period, s
STILL_IMAGES = 8
STILL_INTERVAL = 0.15  # image period, s
DRIFT = 2e-4  # relative change of the bulge per image: 0.6 K/s
REFERENCE_IMAGES = 4
# relative change of the area that counts
SIMILAR_AREA = 0.05
WORKERS = 2


@dataclass(frozen=True, eq=False)
class RecordedPress:
    """Recorded camera images: flat, inflated to `gauge_pressure`, Pa, and the load."""

    design: SensorDesign
    flat: Sequence[Image]
    rest: Sequence[Image]
    gauge_pressure: float
    images: Sequence[Image]


@dataclass(frozen=True, eq=False)
class TouchResult:
    """Results of all images of the loads, (n,) each.

    Normal `force`, N, and its `sd`, number of `markers`, contact `area`, m^2. `reported` combines
    status, contact, slip and number of patches.
    """

    force: Array
    sd: Array
    markers: Array
    area: Array
    reported: NDArray[np.str_]


@dataclass(frozen=True, eq=False)
class Circles:
    """Circles of one image: positions, px, depth, m, with its sd, and `status`."""

    uv: Array
    depth: Array
    sd: Array
    status: NDArray[np.str_]


def record(sensor: str, indenter: str, at: tuple[float, float], tilt: float) -> RecordedPress:
    """Record an indentation in steps, a drag, and the lift."""
    design = load_sensor(sensor)
    world = PressWorld(design, Indenter.parse(indenter), at=at, tilt=tilt)
    view = View(world, design, seed=1)
    world.inflate(0.0, seal=False)
    flat = [view.image() for _ in range(REFERENCE_IMAGES)]
    gauge = design.chamber.supply_gauge
    world.inflate(gauge, seal=True)
    rest = [view.image() for _ in range(REFERENCE_IMAGES)]
    positions = [(depth, 0.0) for depth in DEPTHS]
    positions += [(DEPTHS[-1], SHEAR * part / 3) for part in (1, 2, 3)]
    positions += [(DEPTHS[0], SHEAR), (-2e-3, SHEAR), (-2e-3, SHEAR)]
    images = []
    for number, (depth, shear) in enumerate(positions):
        world.drive(depth, shear)
        pixels = view.image().pixels
        images.append(Image(pixels, number * INTERVAL))
    p, n = world.marker_poses(0)
    for number in range(STILL_IMAGES):  # no contact while the gas cools
        sunk = p * [1.0, 1.0, 1.0 - DRIFT * number]
        time = (len(positions) - 1) * INTERVAL + (number + 1) * STILL_INTERVAL
        images.append(view.renderer.render(sunk, n, time))
    return RecordedPress(design, flat, rest, gauge, images)


def estimate_presses(presses: Sequence[RecordedPress], settings: Settings) -> TouchResult:
    """Estimate all loads with these settings; without a force if a reference is refused."""
    rows: list[tuple[Any, ...]] = []
    for press in presses:
        rows += _estimate_images(press, settings)
    force, sd, markers, area, reported = zip(*rows, strict=True)
    return TouchResult(
        np.array(force), np.array(sd), np.array(markers), np.array(area), np.array(reported)
    )


def _estimate_images(press: RecordedPress, settings: Settings) -> list[tuple[Any, ...]]:
    rows: list[tuple[Any, ...]] = []
    try:
        sensing_pipeline = SensingPipeline(press.design, settings=settings)
        state = sensing_pipeline.measure_flat_reference(
            sensing_pipeline.initial_state(), press.flat
        )
        state = sensing_pipeline.measure_rest_reference(state, press.rest, press.gauge_pressure)
        for image in press.images:
            touch, state = sensing_pipeline.step(state, image, image.time)
            rows.append(_row(touch))
    except (MjtactileError, np.linalg.LinAlgError) as error:
        left = len(press.images) - len(rows)
        rows += [(np.nan, np.nan, 0, 0.0, type(error).__name__)] * left
    return rows


def _row(touch: Touch) -> tuple[Any, ...]:
    markers = 0 if touch.markers is None else len(touch.markers)
    area = 0.0 if touch.contact is None else touch.contact.area
    slips = "" if touch.slip is None else touch.slip.state
    reported = f"{touch.status.code.value} {touch.touching} {slips} {len(touch.patches)}"
    return touch.force_normal, touch.force_normal_sd, markers, area, reported


def shots(presses: Sequence[RecordedPress]) -> list[tuple[Image, RecordedPress]]:
    """Return test photographs: sharp, soft, noisy, black and white, with a bright window."""
    found = []
    rng = np.random.default_rng(0)
    dense, coarse = presses[0], presses[-1]
    sharp = dense.images[4].pixels
    sampled = cv2.threshold(sharp, 110, 255, cv2.THRESH_BINARY)[1]
    glare = sharp.copy()
    glare[:, : sharp.shape[1] // 3] = np.minimum(glare[:, : sharp.shape[1] // 3] * 1.9, 255)
    small = cv2.resize(sharp, None, fx=0.35, fy=0.35, interpolation=cv2.INTER_AREA)
    framed = np.pad(small, 120, constant_values=40)
    bent = np.round(255 * (sharp / 255.0) ** (1 / 2.2)).astype(np.uint8)
    found += [(Image(item), dense) for item in (sampled, glare, bent)]
    found += [(Image(framed), dense)]
    large = coarse.images[4].pixels
    soft = cv2.GaussianBlur(large, (0, 0), 2.0)
    noise = rng.normal(0, 6, large.shape)
    found += [(Image(np.clip(soft + noise, 0, 255).astype(np.uint8)), coarse)]
    return found


def detect_all(images: Sequence[tuple[Image, RecordedPress]], settings: Settings) -> list[Circles]:
    """Detect the circles of all images by `locate` with these settings."""
    return [_detect(image, press, settings) for image, press in images]


def _detect(image: Image, press: RecordedPress, settings: Settings) -> Circles:
    camera = Camera.from_design(press.design.camera, press.design.glass)
    radius = press.design.markers.radius
    try:
        found = detect_circles(image, camera, radius, gamma="auto", settings=settings)
    except (MjtactileError, np.linalg.LinAlgError):
        return Circles(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0, "<U24"))
    poses = found.poses
    sd = np.sqrt(poses.cov_p[:, 2, 2])
    return Circles(found.ellipses.center_px, poses.p_CM[:, 2], sd, poses.status)


# -- changes


def touch_change(before: TouchResult, now: TouchResult) -> dict[str, float]:
    """Compare two sets of touch results.

    The change of the estimated force is an rms, N (NaN where unknown). The change of its standard
    deviation is a median ratio, that of the marker count a mean. The last value counts images with
    another status, or with an area that differs by 5 %.
    """
    known = np.isfinite(before.force) & np.isfinite(now.force)
    off = now.force[known] - before.force[known]
    area_off = np.abs(now.area - before.area) > SIMILAR_AREA * np.maximum(before.area, now.area)
    return {
        "force_N": _rms(off),
        "bar": _median_ratio(now.sd[known], before.sd[known]),
        "markers": float((now.markers - before.markers).mean()),
        "reported": int(((now.reported != before.reported) | area_off).sum()),
    }


def image_change(before: Sequence[Circles], now: Sequence[Circles]) -> dict[str, float]:
    """Compare two sets of circles.

    Count circles that appear, disappear or change status. Compute the depth change (rms, m) and the
    change of standard deviations (median ratio).
    """
    off: list[float] = []
    ratios: list[float] = []
    changed = 0
    for old, new in zip(before, now, strict=True):
        pairs = _pairs(old, new)
        changed += len(old.uv) + len(new.uv) - 2 * len(pairs)
        for i, j in pairs:
            changed += int(old.status[i] != new.status[j])
            if old.status[i] == new.status[j] == "ok":
                off.append(float(new.depth[j] - old.depth[i]))
                ratios.append(float(new.sd[j] / old.sd[i]))
    return {
        "circles": changed,
        "depth_m": _rms(np.array(off)),
        "circle_bar": float(np.median(ratios)) if ratios else np.nan,
    }


def _pairs(old: Circles, new: Circles) -> list[tuple[int, int]]:
    """Return the pairs of circles at the same position, within 3 px."""
    if not len(old.uv) or not len(new.uv):
        return []
    distance = np.linalg.norm(old.uv[:, None] - new.uv, axis=2)
    nearest = distance.argmin(axis=1)
    return [(i, int(j)) for i, j in enumerate(nearest) if distance[i, j] < 3]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.square(values).mean())) if len(values) else float("nan")


def _median_ratio(now: Array, before: Array) -> float:
    return float(np.median(now / before)) if len(now) else float("nan")


# -- all numbers


def variants(source: str = TRIED) -> list[tuple[str, float, Any]]:
    """Return name, factor and value of every parameter to test whose `source` ends so.

    Integers are rounded, and values are limited to their allowed range.
    """
    found = []
    for name, default in DEFAULTS.to_dict().items():
        stage, _, field = name.rpartition(".")
        owner = getattr(DEFAULTS, stage) if stage else DEFAULTS
        if not owner.__dataclass_fields__[field].metadata["source"].endswith(source):
            continue
        entry = entries(type(owner))[field]
        for factor in FACTORS:
            values = default if isinstance(default, tuple) else (default,)
            tried = tuple(_within(value * factor, entry) for value in values)
            found.append((name, factor, tried if isinstance(default, tuple) else tried[0]))
    return found


def _within(value: float, entry: Any) -> float:
    value = min(max(value, entry.low), entry.high)
    return round(value) if entry.integer else value


_GIVEN: dict[str, Any] = {}


def _prepare(quick: bool) -> None:
    """Prepare a process: the images, and their results with the default settings."""
    presses = [record(*press) for press in (PRESSES[:1] if quick else PRESSES)]
    images = shots(presses)
    _GIVEN.update(
        presses=presses,
        images=images,
        estimated=estimate_presses(presses, DEFAULTS),
        circles=detect_all(images, DEFAULTS),
    )


def _try(variant: tuple[str, float, Any]) -> dict[str, Any]:
    name, factor, value = variant
    settings = DEFAULTS.override({name: value})
    stage = name.rpartition(".")[0]
    row: dict[str, Any] = {"name": name, "factor": factor, "value": value}
    if stage not in RENDER_STAGES:
        row |= touch_change(_GIVEN["estimated"], estimate_presses(_GIVEN["presses"], settings))
    if stage in (*RENDER_STAGES, *IMAGE_STAGES):
        row |= image_change(_GIVEN["circles"], detect_all(_GIVEN["images"], settings))
    return row


def run(out: Path, quick: bool) -> dict[str, Any]:
    """Halve and double every tuned parameter; results of an interrupted run in `out` are kept."""
    todo = variants()[::20] if quick else variants()
    progress = Progress()
    kept = out / "settings-rows.jsonl"
    rows = [json.loads(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    done = {(row["name"], row["factor"]) for row in rows}
    todo = [variant for variant in todo if variant[:2] not in done]
    with ProcessPoolExecutor(
        WORKERS, get_context("spawn"), initializer=_prepare, initargs=(quick,)
    ) as pool:
        for row in pool.map(_try, todo):
            rows.append(row)
            with kept.open("a") as file:
                file.write(json.dumps(row) + "\n")
            if len(rows) % 20 == 0:
                progress.message(f"{len(rows)} of {len(todo)}")
    result = {"rows": rows, "images": sum(len(DEPTHS) + 6 + STILL_IMAGES for _ in PRESSES)}
    write_json(out / "settings.json", result)
    return result


def table(result: Mapping[str, Any]) -> str:
    """Format the result in Markdown: one row for each parameter that changes a result."""
    by_name: dict[str, list[Mapping[str, Any]]] = {}
    for row in result["rows"]:
        by_name.setdefault(row["name"], []).append(row)
    cells = {name: _cells(rows) if _matters(rows) else [] for name, rows in by_name.items()}
    quiet = sum(not any(row) for row in cells.values())
    small = ", ".join(text for _, text in LITTLE.values())
    lines = [
        f"{len(cells)} parameters; {quiet} change little or nothing here and are left out (below "
        f"{small})."
    ]
    defaults = DEFAULTS.to_dict()
    first = 0
    for columns in TABLES:
        part = slice(first, first + len(columns))
        first = part.stop
        rows = {name: row[part] for name, row in cells.items() if any(row[part])}
        shown = [k for k in range(len(columns)) if any(row[k] for row in rows.values())]
        if not rows:
            continue
        heads = ("parameter", "default", *(columns[k] for k in shown))
        lines += ["", f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
        for name, row in rows.items():
            value = defaults[name]
            values = value if isinstance(value, tuple) else (value,)
            default = ", ".join(f"{v:g}" for v in values)
            lines.append(f"| `{name}` | {default} | {' | '.join(row[k] for k in shown)} |")
    return "\n".join(lines) + "\n"


LITTLE = {
    "force_N": (0.5e-3, "0.5 mN"),
    "bar": (0.05, "5 % of the sd"),
    "reported": (3, "3 images"),
    "circles": (3, "3 circles"),
    "depth_m": (10e-6, "10 um"),
}
"""Change below which a parameter has no row, and its text."""
TABLES = (("force, mN", "sd factor", "markers", "images"), ("circles", "depth, um", "sd factor"))
"""Columns of each table; those without a change are left out."""


def _matters(rows: Sequence[Mapping[str, Any]]) -> bool:
    """Return True if half or twice the value changes a result by a limit or more."""
    return any(
        abs(row[key] - (key == "bar")) >= limit
        for row in rows
        for key, (limit, _) in LITTLE.items()
        if key in row
    )


def _cells(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the changes by one parameter in the order of `TABLES`; empty: no change."""
    return [
        _both(rows, "force_N", lambda x: f"{1e3 * x:.1f}"),
        _both(rows, "bar", lambda x: f"{x:.2f}"),
        _both(rows, "markers", lambda x: f"{x:+.1f}"),
        _both(rows, "reported", lambda x: f"{x:.0f}"),
        _both(rows, "circles", lambda x: f"{x:.0f}"),
        _both(rows, "depth_m", lambda x: f"{1e6 * x:.0f}"),
        _both(rows, "circle_bar", lambda x: f"{x:.2f}"),
    ]


def _both(rows: Sequence[Mapping[str, Any]], key: str, text: Callable[[float], str]) -> str:
    """Format the values at half and at twice; one value if both are alike, "" if unchanged."""
    if key not in rows[0]:
        return ""
    shown = [text(row[key]) if np.isfinite(row[key]) else "-" for row in rows]
    empty = {"0.0", "0", "1.00", "+0.0", "-0.0"}
    if set(shown) <= empty:
        return ""
    return "/".join(shown)
