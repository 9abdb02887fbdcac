"""`mjtactile bench detection-sensitivity`: effect of halving and doubling tuned detection
parameters.

It covers parameters that the images of `bench settings` do not exercise: photographs, and the
status reported where markers fit no shape.

A large ball is pressed with a small and with a large force. Then the markers fit no shape, as for a
torn membrane. The images for `locate` are those of real cameras: sharpened and compressed, flat and
bent, some of them small.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks import setting_sensitivity
from benchmarks.setting_sensitivity import (
    FACTORS,
    INTERVAL,
    REFERENCE_IMAGES,
    RecordedPress,
    estimate_presses,
)
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import MjtactileError
from mjtactile.core.optics import Camera
from mjtactile.core.types import Image
from mjtactile.experiments.test_bench import View
from mjtactile.sensing.pose.circles_from_images import DetectedCircles, detect_circles
from mjtactile.sensing.settings import DEFAULTS, Settings
from mjtactile.sensing.settings.tunable_parameter import SEEN
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

TORN = ("dense", "sphere:25", (1e-3, -1e-3))
TORN_FORCES = (0.7, 1.4)  # forces before the tear, N
TORN_STEP = 3e-4  # depth step of the load, m
TORN_SD = 4e-4  # scatter of markers that fit no shape, m
TORN_IMAGES = 3
SMALL = 0.5  # fraction of an image's size
_NEAR = 3.0  # maximum distance of the same circle in two images, px
_SIMILAR_CERTAINTY = 0.05  # probability of the correct pose


def torn(force: float) -> RecordedPress:
    """Simulate a large ball, pressed with `force` N; then markers that fit no shape."""
    design = load_sensor(TORN[0])
    world = PressWorld(design, Indenter.parse(TORN[1]), at=TORN[2])
    view = View(world, design, seed=1)
    rng = np.random.default_rng(1)
    world.inflate(0.0, seal=False)
    flat = [view.image() for _ in range(REFERENCE_IMAGES)]
    gauge = design.chamber.supply_gauge
    world.inflate(gauge, seal=True)
    rest = [view.image() for _ in range(REFERENCE_IMAGES)]
    pixels = []
    while -ground_truth.contact_force(world, 0)[2] < force:
        world.drive(TORN_STEP * len(pixels), 0.0)
        pixels.append(view.image().pixels)
    p, n = world.marker_poses(0)
    for _ in range(TORN_IMAGES):
        places = p + rng.normal(0, TORN_SD, p.shape) * [1, 1, 0]
        pixels.append(view.renderer.render(places, n, 0.0).pixels)
    images = [Image(one, number * INTERVAL) for number, one in enumerate(pixels)]
    return RecordedPress(design, flat, rest, gauge, images)


def shots(
    presses: Sequence[RecordedPress], bent: RecordedPress
) -> list[tuple[Image, RecordedPress]]:
    """Return the images of `bench setting-sensitivity`, and more of `bent`.

    The latter are sharpened and compressed, reduced in size, or both.
    """
    flat, pressed = bent.flat[0].pixels, bent.images[4].pixels
    more = [_processed(bent.images[0].pixels), _processed(pressed)]
    more += [_small(item) for item in (flat, pressed, _processed(pressed))]
    return [*setting_sensitivity.shots(presses), *((Image(item), bent) for item in more)]


def _processed(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the image with the sharpening and compression of a real camera."""
    soft = cv2.GaussianBlur(pixels, (0, 0), 1.5)
    sharper = cv2.addWeighted(pixels, 1.8, soft, -0.8, 0)
    packed = cv2.imencode(".jpg", sharper, [cv2.IMWRITE_JPEG_QUALITY, 40])[1]
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), np.uint8)


def _small(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    small = cv2.resize(pixels, None, fx=SMALL, fy=SMALL, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8)


def locate(
    images: Sequence[tuple[Image, RecordedPress]], settings: Settings
) -> list[DetectedCircles | None]:
    """Detect the circles of each image; the entry of a refused image is None."""
    found: list[DetectedCircles | None] = []
    for image, press in images:
        camera = Camera.from_design(press.design.camera, press.design.glass)
        radius = press.design.markers.radius
        try:
            found.append(detect_circles(image, camera, radius, gamma="auto", settings=settings))
        except (MjtactileError, np.linalg.LinAlgError):
            found.append(None)
    return found


def change(
    before: Sequence[DetectedCircles | None], now: Sequence[DetectedCircles | None]
) -> dict[str, float]:
    """Compare two sets of detections.

    Count circles that appear, disappear or change status, and circles with another pose
    probability. Compute the depth change (rms, m) and the change of standard deviations. The latter
    is the median ratio of the image where it is largest.
    """
    circles = poses = 0
    off: list[float] = []
    bars = [1.0]
    for old, new in zip(before, now, strict=True):
        if old is None or new is None:
            circles += sum(len(item.sure) for item in (old, new) if item is not None)
            continue
        pairs = _pairs(old, new)
        status = [(old.poses.status[i], new.poses.status[j]) for i, j in pairs]
        circles += len(old.sure) + len(new.sure) - 2 * len(pairs)
        circles += sum(one != other for one, other in status)
        poses += sum(abs(old.sure[i] - new.sure[j]) > _SIMILAR_CERTAINTY for i, j in pairs)
        good = [
            pair for pair, reported in zip(pairs, status, strict=True) if reported == ("ok", "ok")
        ]
        off += [float(new.poses.p_CM[j, 2] - old.poses.p_CM[i, 2]) for i, j in good]
        ratios = [new.poses.cov_p[j, 2, 2] / old.poses.cov_p[i, 2, 2] for i, j in good]
        bars.append(float(np.sqrt(np.median(ratios))) if ratios else 1.0)
    return {
        "circles": int(circles),
        "poses": int(poses),
        "depth_m": float(np.sqrt(np.mean(np.square(off)))) if off else 0.0,
        "circle_bar": max(bars, key=lambda ratio: abs(np.log(ratio))),
    }


def _pairs(old: DetectedCircles, new: DetectedCircles) -> list[tuple[int, int]]:
    offset = old.ellipses.center_px[:, None] - new.ellipses.center_px
    distance = np.linalg.norm(offset, axis=2)
    if not distance.size:
        return []
    nearest = distance.argmin(axis=1).tolist()
    return [(i, j) for i, j in enumerate(nearest) if distance[i, j] < _NEAR]


def run(out: Path, quick: bool = False) -> dict[str, Any]:
    """Vary every parameter whose source states that it was tuned here."""
    del out
    todo = setting_sensitivity.variants(SEEN)
    presses = [setting_sensitivity.record(*press) for press in setting_sensitivity.PRESSES]
    images = shots(presses, presses[0])
    presses += [torn(force) for force in TORN_FORCES]
    estimated, located = estimate_presses(presses, DEFAULTS), locate(images, DEFAULTS)
    rows = []
    for name, factor, value in todo[: 2 if quick else None]:
        settings = DEFAULTS.override({name: value})
        row = {"name": name, "factor": factor, "value": value}
        row |= setting_sensitivity.touch_change(estimated, estimate_presses(presses, settings))
        row |= change(located, locate(images, settings))
        rows.append(row)
    return {"rows": rows}


def table(result: Mapping[str, Any]) -> str:
    """Format the effects of half and twice each parameter as a Markdown table."""
    defaults = DEFAULTS.to_dict()
    lines = [
        "| parameter | default | force, mN | images | circles | poses | depth, um | sd factor |",
        "|---|---|---|---|---|---|---|---|",
    ]
    rows = result["rows"]
    for half, twice in zip(rows[::2], rows[1::2], strict=True):
        cells = [
            _both(half, twice, "force_N", 1e3, ".1f"),
            _both(half, twice, "reported", 1, ".0f"),
            _both(half, twice, "circles", 1, ".0f"),
            _both(half, twice, "poses", 1, ".0f"),
            _both(half, twice, "depth_m", 1e6, ".0f"),
            _both(half, twice, "circle_bar", 1, ".2f"),
        ]
        value = defaults[half["name"]]
        shown = ", ".join(f"{v:g}" for v in (value if isinstance(value, tuple) else (value,)))
        lines.append(f"| `{half['name']}` | {shown} | {' | '.join(cells)} |")
    assert len(FACTORS) == 2
    return "\n".join(lines) + "\n"


def _both(half: Mapping[str, Any], twice: Mapping[str, Any], key: str, unit: float, by: str) -> str:
    """Format the values at half and at twice; "" if both are unchanged."""
    shown = [format(unit * row[key], by) for row in (half, twice)]
    return "" if set(shown) <= {"0", "0.0", "1.00"} else "/".join(shown)
