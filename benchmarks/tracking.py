"""`mjtactile bench tracking`: marker tracking from image to image, against a search of every image.

Sequences of a moving membrane have one kind of disturbance each: hands and glare in front of the
markers, a camera that jumps, lost images, 15 Hz, taps, fading markers. Each image is evaluated by
`tracking.follow` and by `markers.search`. Both are compared with the rendered marker positions.

A tracked, trusted marker is wrong if its error exceeds its uncertainty, while the search was right
or flagged it. A marker that the search finds and the tracking misses twice in a row counts as
missed.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mjtactile.core import geometry, optics
from mjtactile.core.design import load_sensor
from mjtactile.core.optics import Camera
from mjtactile.core.types import Array, Ellipses, Image
from mjtactile.runtime.progress import Progress
from mjtactile.sensing.image import markers, tracking
from mjtactile.sensing.image.ellipse_fit import as_ellipses
from mjtactile.sim.rendering.renderer import Renderer

LENGTH = 100  # images of a sequence
SEQUENCES = 1000
SEQUENCES_QUICK = 8
SENSOR = "dense"
# an error beyond so many sd and px is wrong
_SD = 6.0
_FLOOR = 0.05
_SAME = 3.0  # maximum distance of two centers of the same marker, px

Floats = Array
Notify = Callable[[str], None]


@dataclass(frozen=True)
class LabelledImage:
    """One image, the true centres (M, 2) px of the markers' ellipses in it, and its time."""

    image: Image
    centers: Array


def run(out: Path, *, quick: bool = False, notify: Notify | None = None) -> dict[str, Any]:
    """Evaluate the sequences, and return counts for each kind of disturbance."""
    notify = notify or Progress().message
    seeds = range(SEQUENCES_QUICK if quick else SEQUENCES)
    rows: list[dict[str, Any]] = []
    with ProcessPoolExecutor(max_workers=1 if quick else os.cpu_count()) as pool:
        for k, row in enumerate(pool.map(sequence_row, seeds, chunksize=1)):
            rows.append(row)
            if k % 20 == 0:
                notify(f"{k} of {len(seeds)} sequences")
    groups = {"all": rows} | {name: [row for row in rows if row["kind"] == name] for name in KINDS}
    return {"groups": {name: _sums(group) for name, group in groups.items()}, "rows": rows}


def sequence_row(seed: int) -> dict[str, Any]:
    """Evaluate one sequence with both methods."""
    design = load_sensor(SENSOR)
    camera = Camera.from_design(design.camera, design.glass)
    minimum = max(1.5, 0.33 * camera.fx * design.markers.radius / design.camera.distance)
    kind = list(KINDS)[seed % len(KINDS)]
    row = {
        "seed": seed,
        "kind": kind,
        "images": 0,
        "searched": 0,
        "markers": 0,
        "wrong": 0,
        "missed_twice": 0,
        "missed": 0,
        "difference_sd": 0.0,
    }
    tracks = None
    missing = np.zeros(design.markers.count, bool)
    for moment in moments(kind, seed):
        before = tracks
        followed, tracks = tracking.follow(
            moment.image, before, design.markers.count, min_radius_px=minimum
        )
        searched = as_ellipses(
            *markers.search(markers.grey_image(moment.image), min_radius_px=minimum)
        )
        (mine, off, sd), (theirs, theirs_off, theirs_sd) = (
            _errors(found, moment.centers) for found in (followed, searched)
        )
        wrong = mine & _is_wrong(off, sd) & ~(theirs & (off < theirs_off + theirs_sd))
        missed = theirs & ~mine
        both = mine & theirs
        row["images"] += 1
        row["searched"] += int(
            before is None
            or tracks is None
            or tracks.images_before_search != before.images_before_search - 1
        )
        row["markers"] += int(theirs.sum())
        row["wrong"] += int(wrong.sum())
        row["missed"] += int(missed.sum())
        row["missed_twice"] += int((missed & missing).sum())
        if both.any():
            row["difference_sd"] = max(
                row["difference_sd"], float((np.abs(off - theirs_off) / theirs_sd)[both].max())
            )
        missing = missed
    return row


def _is_wrong(off: Array, sd: Array) -> Array:
    return off > np.maximum(_SD * sd, _FLOOR)


def _errors(found: Ellipses, truth: Array) -> tuple[Array, Array, Array]:
    """Match trusted ellipses to the true centres.

    Return True where one is present, its error, px, and its reported standard deviation.
    """
    good = np.flatnonzero(found.status == "ok")
    has = np.zeros(len(truth), bool)
    off = np.full(len(truth), np.inf)
    sd = np.ones(len(truth))
    if not len(good):
        return has, off, sd
    distance = np.linalg.norm(truth[:, None] - found.center_px[good], axis=2)
    nearest = distance.argmin(axis=1)
    off = distance[np.arange(len(truth)), nearest]
    variance = found.cov[good[nearest]]
    return off < _SAME, off, np.sqrt(variance[:, 0, 0] + variance[:, 1, 1])


# -- the sequences
# --------------------------------------------------------------------------------


def moments(kind: str, seed: int) -> Iterator[LabelledImage]:
    """Yield the images of a sequence."""
    design = load_sensor(SENSOR)
    rng = np.random.default_rng(seed)
    renderer = Renderer(design, seed=seed)
    camera = renderer.camera
    rate, disturb = KINDS[kind]
    state: dict[str, Any] = {}
    dents = [_dent(rng, rate, kind) for _ in range(3)]
    time = 0.0
    for k in range(LENGTH):
        time += (
            1 + (rng.integers(1, 4) if kind == "lost images" and rng.random() < 0.2 else 0)
        ) / rate
        p_SM, n_S = _membrane(design.markers.p_SM, [dent(time) for dent in dents])
        grey = renderer.irradiance_image(p_SM, n_S)
        truth = _centers(camera, p_SM - design.camera.p_SC, n_S, design.markers.radius)
        grey, truth = disturb(grey, truth, k, state, rng)
        yield LabelledImage(
            renderer.expose(grey.astype(np.float32, copy=False), time, rng=rng), truth
        )


def _dent(
    rng: np.random.Generator, rate: float, kind: str
) -> Callable[[float], tuple[Array, float, float]]:
    """Return a function of time, s, that gives position (2,), depth and width of a dent, m.

    A tap lasts for one or two images.
    """
    start = rng.uniform(-10e-3, 10e-3, 2)
    displacement = rng.uniform(-6e-3, 6e-3, 2)
    depth = rng.uniform(-3e-3, 1e-3)
    width = rng.uniform(5e-3, 12e-3)
    period = rng.uniform(0.5, 2.0)
    taps = np.sort(rng.uniform(0, LENGTH / rate, 6))

    def at(time: float) -> tuple[Array, float, float]:
        if kind == "taps":
            fraction = float(np.clip(1 - np.abs(time - taps).min() * rate / 2.5, 0, 1))
        else:
            fraction = 0.5 - 0.5 * np.cos(2 * np.pi * time / period)
        return (
            start + displacement * np.sin(2 * np.pi * time / (3 * period)),
            fraction * depth,
            width,
        )

    return at


def _membrane(flat: Array, dents: list[tuple[Array, float, float]]) -> tuple[Array, Array]:
    """Return positions and unit normals (M, 3) of markers on a bulge with dents.

    The membrane slides slightly with the dents.
    """
    x, y = flat[:, :2].T / np.abs(flat[:, :2]).max(axis=0)[:, None] / 1.3
    p = flat.copy()
    slope = np.zeros((len(flat), 2))
    p[:, 2] += 3e-3 * (1 - x**2) * (1 - y**2)
    for place, depth, width in dents:
        off = flat[:, :2] - place
        bump = depth * np.exp(-(off**2).sum(axis=1) / width**2)
        p[:, 2] += bump
        p[:, :2] += 0.1 * bump[:, None]
        slope -= 2 * bump[:, None] * off / width**2
    n = -geometry.normal_from_slope(slope[:, 0], slope[:, 1])
    return p, n


def _centers(camera: Camera, p_CM: Array, n: Array, radius: float) -> Array:
    """Return the centers (M, 2), px, of the circles' images: centroids of their projected areas."""
    t = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    a, b = geometry.tangents(n)
    rim = p_CM[:, None] + radius * (
        np.cos(t)[:, None] * a[:, None] + np.sin(t)[:, None] * b[:, None]
    )
    x, y = np.moveaxis(optics.project(camera, rim), -1, 0)
    x2 = np.roll(x, -1, axis=1)
    y2 = np.roll(y, -1, axis=1)
    cross = x * y2 - x2 * y
    return (
        np.stack([((x + x2) * cross).sum(axis=1), ((y + y2) * cross).sum(axis=1)], axis=1)
        / (3 * cross.sum(axis=1))[:, None]
    )


def _nothing(
    grey: Floats, truth: Array, _: int, __: dict, ___: np.random.Generator
) -> tuple[Floats, Array]:
    return grey, truth


def _occlusion(
    grey: Floats, truth: Array, k: int, state: dict, rng: np.random.Generator
) -> tuple[Floats, Array]:
    """Add a long gray object that moves across the image."""
    if k % 30 == 0:
        state["occlusion"] = (
            rng.uniform([0, 0], [640, 480]),
            rng.normal(0, 25, 2),
            rng.uniform(20, 90, 2),
            rng.uniform(20, 190),
        )
    place, displacement, size, level = state["occlusion"]
    at = place + displacement * (k % 30 - 10)
    grey = grey.copy()
    cv2.ellipse(
        grey,
        at.astype(int).tolist(),
        size.astype(int).tolist(),
        10.0 * (k % 30),
        0,
        360,
        float(level),
        -1,
        cv2.LINE_AA,
    )
    return grey, truth


def _glare(
    grey: Floats, truth: Array, k: int, state: dict, rng: np.random.Generator
) -> tuple[Floats, Array]:
    """Add soft bright spots that move."""
    if k == 0:
        state["glare"] = (
            rng.uniform([0, 0], [640, 480], (4, 2)),
            rng.normal(0, 3, (4, 2)),
            rng.uniform(4, 25, 4),
            rng.uniform(40, 200, 4),
        )
    places, displacements, sizes, levels = state["glare"]
    v, u = np.mgrid[: grey.shape[0], : grey.shape[1]].astype(np.float32)
    for place, size, level in zip(places + k * displacements, sizes, levels, strict=True):
        grey = grey + level * np.exp(
            -((u - place[0]) ** 2 + (v - place[1]) ** 2) / (2 * size**2)
        ).astype(np.float32)
    return grey, truth


def _jump(
    grey: Floats, truth: Array, k: int, state: dict, rng: np.random.Generator
) -> tuple[Floats, Array]:
    """Simulate camera knocks: from one image to the next, the image shifts by up to two pitches."""
    if k == 0 or rng.random() < 0.08:
        state["shift"] = rng.uniform(-60, 60, 2) * rng.choice([0.05, 1.0])
    du, dv = state["shift"]
    moved = cv2.warpAffine(
        grey,
        np.array([[1, 0, du], [0, 1, dv]]),
        grey.shape[::-1],
        flags=cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return moved, truth + state["shift"]


def _fade(
    grey: Floats, truth: Array, k: int, state: dict, rng: np.random.Generator
) -> tuple[Floats, Array]:
    """Fade some markers out, and restore them."""
    if k % 20 == 0:
        state["gone"] = rng.choice(len(truth), 5, replace=False)
    grey = grey.copy()
    fraction = min(1.0, (k % 20) / 10)
    for u, v in truth[state["gone"]].tolist():
        cut = grey[max(int(v) - 16, 0) : int(v) + 17, max(int(u) - 16, 0) : int(u) + 17]
        cut += fraction * (np.percentile(cut, 90) - cut)
    return grey, truth


KINDS: dict[str, tuple[float, Callable]] = {
    "undisturbed": (30.0, _nothing),
    "15 Hz": (15.0, _nothing),
    "taps": (30.0, _nothing),
    "lost images": (30.0, _nothing),
    "occlusion": (30.0, _occlusion),
    "glare": (30.0, _glare),
    "a camera that jumps": (30.0, _jump),
    "markers that fade": (30.0, _fade),
}
"""Kind of sequence: image rate, Hz, and disturbance."""


# -- the table
# --------------------------------------------------------------------------------


def _sums(rows: list[dict[str, Any]]) -> dict[str, Any]:
    total = {
        key: sum(row[key] for row in rows)
        for key in ("images", "searched", "markers", "wrong", "missed", "missed_twice")
    }
    return total | {"difference_sd": max((row["difference_sd"] for row in rows), default=0.0)}


_LABELS = {
    "occlusion": "occlusion",
    "a camera that jumps": "camera displaced",
    "markers that fade": "fading markers",
}


def table(result: Mapping[str, Any]) -> str:
    """Format the result as a Markdown table."""
    lines = [
        "| sequences | images | searched | markers | wrong | missed once | missed twice in a "
        "row | largest difference, sd |",
        "|---" * 8 + "|",
    ]
    for name, g in result["groups"].items():
        numbers = [g["markers"], g["wrong"], g["missed"] - g["missed_twice"], g["missed_twice"]]
        searched = 100 * g["searched"] / max(g["images"], 1)
        lines.append(
            f"| {_LABELS.get(name, name)} | {g['images']} | {searched:.0f} % | "
            + " | ".join(map(str, numbers))
            + f" | {g['difference_sd']:.1f} |"
        )
    return "\n".join(lines) + "\n"
