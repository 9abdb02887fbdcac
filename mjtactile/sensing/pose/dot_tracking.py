"""Tracking of circles on any marked skin from image to image.

Examples are gels, pins, and bubbles without a sensor file. Results are in pixels. They are also in
space if the camera and the radius of the circles are given.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjtactile.core import optics
from mjtactile.core.errors import InputError
from mjtactile.core.sensor_parts import CameraDesign
from mjtactile.core.signature_checks import above, validated
from mjtactile.core.types import Array, CirclePoses, Ellipses, Image
from mjtactile.sensing.image.exhaustive_detection import detect_thoroughly
from mjtactile.sensing.image.markers import Polarity, grey_image
from mjtactile.sensing.pose.circles_from_images import detect_circles, plain_grey
from mjtactile.sensing.settings import DEFAULTS, Settings

UNTRACKED = -1  # id of a circle that is not tracked
CUT = "cut by image border"
_GATE = 0.45  # maximum motion relative to the others, as a fraction of the circle distance
_NEW = 0.7  # distance from all tracked circles, as a fraction of it: a new circle
_SMALL = 0.6  # minimum size relative to the median: less is a speck
_EDGE = 0.1  # fraction of circles without a partner from which a larger motion is considered
_CLEARLY = 0.5  # fraction of them that a larger motion may leave without a partner
_NEIGHBORS = 8  # of a circle
_FEWEST = 2  # minimum number of complete circles at the start


@dataclass(frozen=True, eq=False)
class TrackedCircles:
    """Tracked circles of one image.

    Attributes:
        ids: Index of the track of each circle (N,); -1: not tracked, a speck or a circle cut by the
            image border.
        ellipses: Ellipses of the N circles, with their status.
        poses: Poses in space; None: camera or radius were not given.
    """

    ids: NDArray[np.int64]
    ellipses: Ellipses
    poses: CirclePoses | None


@dataclass(frozen=True, eq=False)
class _Skin:
    """Last or predicted positions of the tracked circles (M, 2), px, their usual distance and size,
    px."""

    positions: Array
    pitch: float
    size: float


@validated(radius=above(0), min_radius_px=above(0))
def track_circles(
    images: Iterable[NDArray | Image],
    camera: optics.Camera | CameraDesign | None = None,
    radius: float | None = None,
    *,
    polarity: Polarity = "dark",
    min_radius_px: float = 2.0,
    settings: Settings | None = None,
) -> Iterator[TrackedCircles]:
    """Find the circles of a marked skin in a sequence of images, and track each.

    Every image is searched completely, so that lost circles are found again. Between images, all
    circles may move together by up to their distance if the edges of the pattern are visible, else
    by less than half of it. In addition, each may move by less than half of their distance.

    Args:
        images: Gray levels or colors (H, W) or (H, W, 3), or `Image`s.
        camera: Lens and glass; None: pixels only.
        radius: Radius of the circles, m; None: pixels only.
        polarity: Circles "dark" on a bright background, or "bright".
        min_radius_px: Minimum radius to search for.
        settings: Settings of the stages; None: the defaults.

    Yields:
        The circles of each image.

    Raises:
        InputError: An image, a radius or an option is invalid; an image has another size than the
            camera; or only one of camera and radius is given.
    """
    if (camera is None) != (radius is None):
        raise InputError(
            "camera and radius must be given together", source="track_circles", field="radius"
        )
    settings = DEFAULTS if settings is None else settings
    skin: _Skin | None = None
    for image in images:
        poses = None
        if camera is None or radius is None:
            grey = grey_image(plain_grey(image))
            ellipses, _, _ = detect_thoroughly(
                grey, polarity=polarity, min_radius_px=min_radius_px, settings=settings
            )
        else:
            found = detect_circles(
                image,
                camera,
                radius,
                polarity=polarity,
                min_radius_px=min_radius_px,
                settings=settings,
            )
            ellipses = found.ellipses
            poses = found.poses
        pixels = image.pixels if isinstance(image, Image) else image
        ids, skin = _followed(skin, ellipses, np.shape(pixels)[1::-1])
        yield TrackedCircles(ids, ellipses, poses)


def _followed(
    skin: _Skin | None, ellipses: Ellipses, size_px: tuple[int, ...]
) -> tuple[NDArray[np.int64], _Skin | None]:
    """Return the track index of each circle, and the updated tracks. `size_px` is the width and
    height of the image."""
    ids = np.full(len(ellipses), UNTRACKED)
    complete = np.flatnonzero(ellipses.status != CUT)
    size = skin.size if skin is not None else _middle(ellipses.semi_axes_px[complete, 1])
    complete = complete[ellipses.semi_axes_px[complete, 1] > _SMALL * size]
    centers = ellipses.center_px[complete]
    if skin is None:
        if len(centers) < _FEWEST:
            return ids, None
        ids[complete] = np.arange(len(centers))
        return ids, _Skin(centers, _distance(centers), size)
    if not len(centers):
        return ids, skin
    expected = skin.positions + _motion(skin, centers, np.array(size_px))
    distance = np.linalg.norm(expected[:, None] - centers[None], axis=2)
    nearest = distance.argmin(axis=1)
    # one-to-one: each circle matches one tracked circle
    mutual = distance.argmin(axis=0)[nearest] == np.arange(len(expected))
    mutual &= distance[np.arange(len(expected)), nearest] < _GATE * skin.pitch
    ids[complete[nearest[mutual]]] = np.flatnonzero(mutual)
    expected[mutual] = centers[nearest[mutual]]
    new = distance.min(axis=0) > _NEW * skin.pitch
    ids[complete[new]] = len(expected) + np.arange(int(new.sum()))
    return ids, _Skin(np.concatenate([expected, centers[new]]), skin.pitch, skin.size)


def _motion(skin: _Skin, centers: Array, size_px: Array) -> Array:
    """Compute the common motion (2,), px, of the circles to `centers` (n, 2).

    A motion by more than half of the circles' distance resembles a smaller one to the neighbors.
    The edges of the pattern then remain without a partner inside the image. In this case the
    motions to the neighbors are compared.
    """
    moved = _together(skin, centers, np.zeros(2))
    unmatched = _unmatched(skin, centers, moved, size_px)
    if unmatched <= _EDGE * len(centers):
        return moved
    offsets = centers - centers[np.linalg.norm(centers - centers.mean(axis=0), axis=1).argmin()]
    nearest = np.linalg.norm(offsets, axis=1).argsort()[1 : 1 + _NEIGHBORS]
    others = [_together(skin, centers, moved + offset) for offset in offsets[nearest]]
    counts = [_unmatched(skin, centers, other, size_px) for other in others]
    if min(counts, default=unmatched) >= _CLEARLY * unmatched:
        return moved
    return others[int(np.argmin(counts))]


def _unmatched(skin: _Skin, centers: Array, moved: Array, size_px: Array) -> int:
    """Count the tracks and positions without a partner, away from the image border."""
    expected = skin.positions + moved
    distance = np.linalg.norm(expected[:, None] - centers[None], axis=2)
    alone = [distance.min(axis=1), distance.min(axis=0)]
    margin = skin.pitch
    return sum(
        int(
            np.sum((gap > _GATE * margin) & np.all((at > margin) & (at < size_px - margin), axis=1))
        )
        for gap, at in zip(alone, (expected, centers), strict=True)
    )


def _together(skin: _Skin, centers: Array, start: Array) -> Array:
    """Compute the motion (2,), px, of most circles near `start`. It is the median offset of all
    circles to the nearest of `centers` (n, 2). A second iteration starts from the result."""
    moved = start
    for _ in range(2):
        distance = skin.positions[:, None] + moved - centers[None]
        nearest = np.linalg.norm(distance, axis=2).argmin(axis=1)
        moved = moved - np.median(distance[np.arange(len(distance)), nearest], axis=0)
    return moved


def _distance(centers: Array) -> float:
    """Return the median distance, px, of the `centers` (n, 2) to their nearest neighbors."""
    distance = np.linalg.norm(centers[:, None] - centers[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    return _middle(distance.min(axis=1))


def _middle(values: Array) -> float:
    return float(np.median(values)) if len(values) else 0.0
