"""Ground truth of an object's surface, for scoring only."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial import KDTree

from mjtactile.core.types import Array
from mjtactile.sim.scenes.objects import ObjectModel, read_spec

_RAYS = 6000
_FAR = 0.15  # distance at which rays start, m


@dataclass(frozen=True, eq=False)
class TrueSurface:
    """Points (N, 3) m spread evenly over an object's outer surface, with its own `model`."""

    points: Array
    model: mujoco.MjModel
    data: mujoco.MjData

    @classmethod
    def of(cls, grasped: ObjectModel, seed: int = 0) -> TrueSurface:
        """Sample the surface of an object at rest by random lines, in proportion to area."""
        spec = read_spec(grasped)
        item = spec.body("object")
        for other in list(spec.worldbody.bodies):
            if other.name != "object":
                spec.delete(other)
        item.pos = [0.0, 0.0, 0.0]
        for joint in list(item.joints):
            if joint.type == mujoco.mjtJoint.mjJNT_FREE:
                spec.delete(joint)
        model = spec.compile()
        model.geom_group[:] = np.where(model.geom_contype & 1, 0, 5)
        model.geom_rgba[:, 3] = 1.0  # rays ignore transparent geoms
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        radius = float(np.abs(model.geom_aabb[:, 3:]).sum()) if model.ngeom else 0.05
        radius = min(radius, 0.1)
        return cls(_ray_hits(model, data, radius, seed), model, data)

    def off(self, p: Array, n: Array) -> Array:
        """Return the signed distance (N,) m of points `p` outside the surface, along normals `n`.

        If such a line misses the surface, it is the distance to the nearest surface point.
        """
        distance = np.array(
            [
                _FAR - _ray(self.model, self.data, at + _FAR * out, -out)
                for at, out in zip(p, n, strict=True)
            ]
        )
        nearest = KDTree(self.points).query(p)[0]
        wild = (distance > 0.1) | (np.abs(distance) > 3 * nearest + 2e-3)
        return np.where(wild, nearest, distance)

    def extents(self, axes: Array) -> Array:
        """Return the extents (k,) m along each of `axes` (3, k), columns."""
        return np.array([self._end(axis) + self._end(-axis) for axis in axes.T])

    def _end(self, way: Array) -> float:
        """Return the maximum extent along a unit vector, m."""
        best = self.points[int((self.points @ way).argmax())]
        across = np.linalg.svd(way[None])[2][1:]
        turns = np.arange(8) * (np.pi / 4)
        rays = np.column_stack([np.cos(turns), np.sin(turns)]) @ across
        step = _CLIMB
        while step > _CLIMBED:
            starts = best - (best @ way) * way + step * rays
            lengths = [_ray(self.model, self.data, at + _FAR * way, -way) for at in starts]
            heights = np.where(np.array(lengths) < 0, -np.inf, _FAR - np.array(lengths))
            top = int(heights.argmax())
            if heights[top] > best @ way:
                best = starts[top] + heights[top] * way
            else:
                step /= 2
        return float(best @ way)


_CLIMB = 2e-3  # first step of the search, m: about the spacing of the points
_CLIMBED = 2e-5  # last step, m: error within 0.04 um at an end with the curvature of a ball of 5 mm
_GROUPS = np.array([1, 1, 1, 1, 1, 0], np.uint8)


def _ray(model: mujoco.MjModel, data: mujoco.MjData, start: Array, way: Array) -> float:
    """Return the distance from `start` along the unit vector `way`, m; negative without a hit."""
    return mujoco.mj_ray(model, data, start, way, _GROUPS, 1, -1, None)


def _ray_hits(model: mujoco.MjModel, data: mujoco.MjData, radius: float, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(_RAYS):
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        aside = rng.normal(size=3)
        aside -= (aside @ direction) * direction
        aside /= np.linalg.norm(aside)
        start = radius * np.sqrt(rng.random()) * aside - 2 * _FAR * direction
        distance = _ray(model, data, start, direction)
        if distance >= 0:
            found.append(start + distance * direction)
    return np.array(found)
