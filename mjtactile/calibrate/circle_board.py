"""Flat board of equal circles on a square grid, a target for `calibrate.camera`. The number of
circles is arbitrary, and some may be missing.

Intrinsics only require that the circles lie on a square grid. Each image has its own board pose, so
the choice of circle (0, 0) and the grid pitch do not matter. Circles are therefore numbered from a
central circle outwards, from neighbor to neighbor.

The center of a circle's image (an ellipse) is not the image of the circle's center. The offset is f
r^2 sin(t) cos(t)/Z^2 at a tilt t. It is computed from the camera and the board pose and subtracted;
then both are fitted again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mjtactile.calibrate.camera import CORNERS_MIN, BoardView, CameraCalibration, calibrate_camera
from mjtactile.calibrate.intrinsics import DEFAULT, Intrinsics, LensFit, fit_intrinsics
from mjtactile.core.errors import InputError
from mjtactile.core.lens import PLUMB_BOB
from mjtactile.core.types import Array
from mjtactile.sensing.image.exhaustive_detection import detect_thoroughly
from mjtactile.sensing.image.markers import Polarity

_HALF = 500  # offset of the grid indices: ids are (i + half) 2 half + j + half
# maximum deviation of a neighbor from its expected position, as a fraction of the step
_NEAR = 0.25
_ALIKE = 1.6  # maximum size ratio of circles of one board in one image
_SEEDS = 5
# rounds of fit and ellipse center correction; each reduces the error to a hundredth
_ROUNDS = 3
_RIM = 64
_PLAIN = 4.0  # minimum distance of k3 from zero, sd; an unneeded k3 distorts the image corners


@dataclass(frozen=True)
class CircleFinder:
    """Detector of the circles of a board: distance `pitch`, m, and `radius`, m."""

    pitch: float
    radius: float
    polarity: Polarity = "dark"

    def __post_init__(self) -> None:
        if not 0 < self.radius < self.pitch / 2:
            raise InputError(
                f"circles of {1e3 * self.radius:g} mm radius touch each other at a pitch of "
                f"{1e3 * self.pitch:g} mm",
                field="--radius-mm",
            )

    def find(self, name: str, gray: NDArray[np.uint8]) -> BoardView | None:
        """Detect the centers of the circles' ellipses; None for fewer than CORNERS_MIN on one
        grid."""
        ellipses, _, _ = detect_thoroughly(gray, polarity=self.polarity)
        good = ellipses.status == "ok"
        if good.sum() < CORNERS_MIN:
            return None
        size = np.sqrt(ellipses.semi_axes_px[good].prod(axis=1))
        alike = np.abs(np.log(size / np.median(size))) < np.log(_ALIKE)
        uv = ellipses.center_px[good][alike]
        grid_positions = number_grid(uv)
        if len(grid_positions) >= CORNERS_MIN:
            return BoardView(name, _ids(grid_positions), uv[list(grid_positions)])
        return None

    def corners(self, view: BoardView) -> Array:
        """Return the centers (N, 3), m, of the view's circles on the board."""
        i, j = np.divmod(view.ids, 2 * _HALF)
        return self.pitch * np.stack([i - _HALF, j - _HALF, np.zeros(len(i))], axis=1).astype(float)

    def centred(self, view: BoardView, fit: Intrinsics) -> BoardView:
        """Return the view with projected circle centers instead of ellipse centers.

        The fitted camera must be approximately correct.
        """
        centres = self.corners(view)
        pose = fit.pose_of(centres, view.uv)
        t = 2 * np.pi * np.arange(_RIM) / _RIM
        rim = centres[:, None] + self.radius * np.stack(
            [np.cos(t), np.sin(t), np.zeros(_RIM)], axis=1
        )
        rims = fit.project(rim.reshape(-1, 3), *pose).reshape(-1, _RIM, 2)
        centers = fit.project(centres, *pose)
        return replace(view, uv=view.uv - (_centroid(rims) - centers))


def calibrate_from_circles(
    finder: CircleFinder,
    views: Sequence[BoardView],
    size: tuple[int, int],
    options: LensFit = DEFAULT,
) -> CameraCalibration:
    """Run `calibrate_camera` on ellipse centers.

    A plumb_bob lens includes k3 if the caller requests it. It also includes k3 if the fitted value
    clearly differs from zero. In that case the holdout error must not increase.
    """
    raw = list(views)
    full = replace(options, k3=options.model == PLUMB_BOB)
    for _ in range(_ROUNDS if len(raw) >= 3 else 0):
        points = [(finder.corners(view), view.uv) for view in views]
        fit = fit_intrinsics(points, size, full)
        views = [finder.centred(view, fit) for view in raw]
    with_k3 = calibrate_camera(finder, views, size, full)
    if full == options:
        return with_k3
    without = calibrate_camera(finder, views, size, options)
    plain = abs(with_k3.lens.coefficients[4]) > _PLAIN * with_k3.sd[8]
    return with_k3 if plain and with_k3.holdout_px <= without.holdout_px else without


def number_grid(uv: Array) -> dict[int, tuple[int, int]]:
    """Return the grid indices (i, j) of points `uv` (N, 2) px, by point index.

    Points that do not lie on the square grid of a central point are omitted.
    """
    tree = KDTree(uv)
    best = {}
    for seed in np.argsort(((uv - uv.mean(axis=0)) ** 2).sum(axis=1))[:_SEEDS]:
        found = _connected(uv, tree, int(seed))
        best = found if len(found) > len(best) else best
    return best


def _connected(uv: Array, tree: KDTree, seed: int) -> dict[int, tuple[int, int]]:
    """Return the grid indices of the points that are connected to a seed point.

    From neighbor to neighbor, each step is predicted from the last one in that direction.
    """
    basis = _basis(uv, tree, seed)
    if basis is None:
        return {}
    grid_positions = {seed: (0, 0)}
    taken = {(0, 0)}
    queue = deque([(seed, basis)])
    while queue:
        at, steps = queue.popleft()
        for axis in (0, 1):
            for sign in (1, -1):
                neighbor = (
                    grid_positions[at][0] + sign * (axis == 0),
                    grid_positions[at][1] + sign * (axis == 1),
                )
                distance, near = tree.query(uv[at] + sign * steps[axis])
                if (
                    near in grid_positions
                    or neighbor in taken
                    or distance > _NEAR * np.linalg.norm(steps[axis])
                ):
                    continue
                grid_positions[int(near)] = neighbor
                taken.add(neighbor)
                now = steps.copy()
                now[axis] = sign * (uv[near] - uv[at])
                queue.append((int(near), now))
    return grid_positions


def _basis(uv: Array, tree: KDTree, seed: int) -> Array | None:
    """Return the steps (2, 2), px, to the nearest neighbor and to the nearest across it.

    The sine of the angle between the two steps exceeds 0.5. None: no such neighbor.
    """
    near = np.atleast_1d(tree.query(uv[seed], min(9, len(uv)))[1])
    steps = uv[near[1:]] - uv[seed]
    length = np.linalg.norm(steps, axis=1)
    sine = np.abs(steps[:, 0] * steps[0, 1] - steps[:, 1] * steps[0, 0]) / (length * length[0])
    other = np.flatnonzero((sine > 0.5) & (length < 2.5 * length[0]))
    return np.stack([steps[0], steps[other[0]]]) if len(other) else None


def _ids(grid_positions: dict[int, tuple[int, int]]) -> NDArray[np.int32]:
    i, j = np.array(list(grid_positions.values())).T
    return ((i + _HALF) * 2 * _HALF + j + _HALF).astype(np.int32)


def _centroid(polygon: Array) -> Array:
    """Return the centroids (N, 2) of the areas of closed polygons (N, K, 2)."""
    origin = polygon.mean(axis=1, keepdims=True)
    x, y = np.moveaxis(polygon - origin, -1, 0)
    x2 = np.roll(x, -1, axis=1)
    y2 = np.roll(y, -1, axis=1)
    cross = x * y2 - x2 * y
    area = cross.sum(axis=1)
    return origin[:, 0] + np.stack(
        [((x + x2) * cross).sum(axis=1), ((y + y2) * cross).sum(axis=1)], axis=1
    ) / (3 * area[:, None])
