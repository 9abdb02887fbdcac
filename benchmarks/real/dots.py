"""`mjtactile bench dots --data FOLDER`: dots that the marker stage detects on real gels.

A second part tests slip indicators that use marker motion alone.

The recordings are two GelSight Minis in a gripper, from amitparag/Incipient-Slip-Detection
(BSD-2-Clause). FOLDER holds NAME-camera_0.avi and NAME-camera_2.avi of each grip, and `labels.csv`
with columns experiment and slip (0 or 1).

A fitted lattice gives the number of dots: a quadratic in the lattice indices predicts each dot's
image position. A dot counts as whole if its circle lies within the image. A trusted circle is false
if the lattice has no dot there.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile import InputError, TrackedCircles, track_circles
from mjtactile.core.types import Array
from mjtactile.recording.files import write_json
from mjtactile.sensing.pose.dot_tracking import CUT

EVERY = 8  # one frame of this many is evaluated
NEAR = 0.3  # maximum distance from a lattice point, as a fraction of the dots' distance
RIM = 1.5  # minimum distance of a whole dot from the image border, px
SIGNS = ("relaxes", "wanders")
"""Slip indicators of the common motion of all dots: the fraction of the peak by which it has
decreased at the end, and its standard deviation, px, over the last two thirds."""


def run(
    out: Path,
    *,
    quick: bool = False,
    data: Path | None = None,
    notify: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Count the dots in some frames of each video, and compute the indicators of each grip."""
    if data is None:
        raise InputError("needs the recordings' folder", field="--data")
    grips = _labels(Path(data) / "labels.csv")
    rows = []
    for name, slips in list(grips.items())[: 2 if quick else None]:
        counts = np.zeros(4, int)
        signs = []
        for camera in ("camera_0", "camera_2"):
            found = list(track_circles(_frames(Path(data) / f"{name}-{camera}.avi")))
            for tracked in (found[0], found[len(found) // 2], found[-1]):
                counts += dots_of(tracked)
            signs.append(_signs(found))
        complete, detected, trusted, false = counts.tolist()
        row = {
            "grip": name,
            "slips": slips,
            "complete": complete,
            "seen": detected,
            "trusted": trusted,
        }
        row |= {"false": false} | dict(zip(SIGNS, np.max(signs, axis=0).tolist(), strict=True))
        rows.append(row)
        notify(f"{name}: {detected} of {complete} dots, {trusted} trusted, {false} false")
        write_json(Path(out) / "dots.json", {"rows": rows})
    return {"rows": rows, **summary(rows)}


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Sum the dot counts, and compute how well each indicator separates slips from holds."""
    total = {key: sum(row[key] for row in rows) for key in ("complete", "seen", "trusted", "false")}
    slips = np.array([row["slips"] for row in rows], bool)
    signs = {}
    for name in SIGNS:
        values = np.array([row[name] for row in rows])
        signs[name] = {"auc": _auc(values, slips), "right": _left_out(values, slips)}
    return total | {"grips": len(rows), "slips": int(slips.sum()), "signs": signs}


def table(result: Mapping[str, Any]) -> str:
    """Return the results in Markdown."""
    complete = result["complete"]
    lines = [
        "| real gel sensors with dots |  |",
        "|---|---|",
        f"| complete dots in 6 frames of each of {result['grips']} grips | {complete} |",
        f"| detected | {100 * result['seen'] / complete:.1f} % |",
        f"| trusted | {100 * result['trusted'] / complete:.1f} % |",
        f"| trusted detections without a dot | {result['false']} |",
    ]
    words = {"relaxes": "slip by return motion", "wanders": "slip by wandering motion"}
    for name, found in result["signs"].items():
        lines.append(
            f"| {words[name]}: correct, with a threshold from the other grips | "
            f"{found['right']} of {result['grips']} (area under the curve {found['auc']:.2f}) |"
        )
    return "\n".join(lines)


def dots_of(tracked: TrackedCircles) -> NDArray[np.int64]:
    """Count the dots of one frame (4,).

    The counts are: whole dots in the image, detected ones of these, trusted ones of these, and
    trusted circles without a dot.
    """
    ellipses = tracked.ellipses
    size = float(np.median(ellipses.semi_axes_px[:, 0]))
    good = (ellipses.status != CUT) & (ellipses.semi_axes_px[:, 1] > 0.6 * size)
    places = ellipses.center_px[good]
    sites, pitch = lattice(places)
    distance = np.linalg.norm(sites[:, None] - ellipses.center_px[None], axis=2)
    inside = ((sites > size + RIM) & (sites < np.array(IMAGE_SIZE) - 1 - size - RIM)).all(axis=1)
    near = distance < NEAR * pitch
    ok = ellipses.status == "ok"
    detected = near.any(axis=1)
    trusted = (near & ok).any(axis=1)
    false = ok & ~near.any(axis=0)
    return np.array(
        [inside.sum(), (inside & detected).sum(), (inside & trusted).sum(), false.sum()]
    )


IMAGE_SIZE = (320, 240)  # image size of these recordings, px


def lattice(places: Array) -> tuple[Array, float]:
    """Return the predicted dot positions (m, 2), px, and their distance, px.

    The lattice extends one row and column beyond the detected dots.
    """
    distance = np.linalg.norm(places[:, None] - places[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    pitch = float(np.median(distance.min(axis=1)))
    number = {0: (0, 0)}
    todo = [0]
    while todo:
        one = todo.pop()
        for other in np.flatnonzero(distance[one] < 1.3 * pitch).tolist():
            step = np.round((places[other] - places[one]) / pitch).astype(int)
            if other in number or np.abs(step).sum() != 1:
                continue
            number[other] = (number[one][0] + int(step[0]), number[one][1] + int(step[1]))
            todo.append(other)
    which = np.array(list(number))
    at = np.array([number[item] for item in which], float)
    found, *_ = np.linalg.lstsq(_quadratic(at), places[which], rcond=None)
    low, high = at.min(axis=0) - 1, at.max(axis=0) + 1
    all_of_them = np.stack(
        np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)), axis=-1
    ).reshape(-1, 2)
    return _quadratic(all_of_them) @ found, pitch


def _quadratic(at: Array) -> Array:
    i, j = at.T
    return np.column_stack([np.ones_like(i), i, j, i * i, i * j, j * j])


def _signs(found: list[TrackedCircles]) -> tuple[float, float]:
    """Compute the indicators of one video from the median motion of all dots since its first
    frame."""
    first = found[0]
    start = dict(zip(first.ids.tolist(), first.ellipses.center_px, strict=True))
    moved = []
    for tracked in found:
        displacements = [
            place - start[track_id]
            for track_id, place in zip(
                tracked.ids.tolist(), tracked.ellipses.center_px, strict=True
            )
            if track_id >= 0 and track_id in start
        ]
        moved.append(np.median(displacements, axis=0) if displacements else moved[-1])
    motion = np.array(moved)
    size = np.linalg.norm(motion, axis=1)
    late = motion[len(motion) // 3 :]
    wanders = float(np.sqrt(np.square(late - late.mean(axis=0)).sum(axis=1).mean()))
    return 1 - float(size[-1] / max(size.max(), 1e-9)), wanders


def _auc(values: Array, slips: NDArray[np.bool_]) -> float:
    pairs = values[slips][:, None] - values[~slips][None]
    return float(np.mean((pairs > 0) + 0.5 * (pairs == 0))) if pairs.size else float("nan")


def _left_out(values: Array, slips: NDArray[np.bool_]) -> int:
    """Count correct classifications, each by the threshold that is best for the others."""
    right = 0
    for item in range(len(values)):
        others = np.arange(len(values)) != item
        fractions = [np.mean((values[others] > t) == slips[others]) for t in values[others]]
        if not fractions:
            return 0
        threshold = values[others][int(np.argmax(fractions))]
        right += int((values[item] > threshold) == slips[item])
    return right


def _labels(path: Path) -> dict[str, bool]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return {row["experiment"]: row["slip"] == "1" for row in csv.DictReader(file)}
    except (OSError, KeyError) as error:
        raise InputError(
            f"is no list of grips with columns experiment and slip: {error}",
            source=path,
            field="--data",
        ) from error


def _frames(path: Path) -> Iterator[NDArray]:
    video = cv2.VideoCapture(str(path))
    count = 0
    try:
        while True:
            ok, pixels = video.read()
            if not ok:
                break
            if count % EVERY == 0:
                yield pixels
            count += 1
    finally:
        video.release()
    if not count:
        raise InputError("a video without a frame that can be read", source=path, field="--data")
