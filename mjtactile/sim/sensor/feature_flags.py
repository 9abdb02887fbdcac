"""Flags of the geoms that touch a membrane: small features, edges, hulls of meshes."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.flags import Reasons
from mjtactile.core.types import Array
from mjtactile.sim.sensor import feature_size
from mjtactile.sim.sensor.sensor_types import AnySensor


class FeatureFlags:
    """Features of `geoms` (g,), which may touch membranes, with feature radii `sizes` (g,) m."""

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray[np.int64], sizes: Array
    ):
        self._model = model
        self._data = data
        self._geoms = geoms
        self._sizes = sizes
        self._index = np.full(model.ngeom + 1, -1)  # of geom ids, and of -1
        self._index[geoms] = np.arange(len(geoms))
        self._faces, self._sides = (
            np.array([feature_size.edge_half_width(model, int(g), axial) for g in geoms])
            for axial in (1.0, 0.0)
        )
        self._has_edges = np.isfinite(np.minimum(self._faces, self._sides)).tolist()
        self._hulls: dict[int, str | None] = {}  # of those of `_geoms` that have touched

    def touching(self, sensor: AnySensor, rows: NDArray[np.int64]) -> Reasons:
        """Return flags of the geoms in the contacts `rows`: small features, edges, hulls."""
        flags: Reasons = {}
        contact = self._data.contact
        others = self._index[contact.geom[rows]].max(axis=1)  # -1: not one of `_geoms`
        touching = set(others.tolist()) - {-1}
        if not touching:
            return flags
        smallest = min(touching, key=lambda k: self._sizes[k])
        feature = feature_size.resolution_flag(
            self._model,
            int(self._geoms[smallest]),
            float(self._sizes[smallest]),
            sensor.mesh,
            sensor.contact,
        )
        if feature:
            flags["small_feature"] = feature
        if any(self._has_edges[k] for k in touching):
            known = others >= 0
            half_width = self._nearest_edge(rows[known], others[known])
            frame = sensor.design.frame
            edge = feature_size.edge_flag(half_width, sensor.mesh) or feature_size.rim_flag(
                self._rim_distance(sensor, rows[known], others[known]),
                min(frame.length, frame.width),
                sensor.mesh,
            )
            flags |= {"sharp_edge": edge} if edge else {}
        for k in touching:
            if k not in self._hulls:
                self._hulls[k] = feature_size.hull_flag(self._model, int(self._geoms[k]))
            if hull := self._hulls[k]:
                flags["hull"] = hull
        return flags

    def _nearest_edge(self, rows: NDArray[np.int64], others: NDArray[np.int64]) -> float:
        """Return the minimum half width, m, of the touching faces with edges, of geoms `others`."""
        axes = self._data.geom_xmat[self._geoms[others]].reshape(-1, 3, 3)[:, :, 2]
        axial = np.abs(np.einsum("ki,ki->k", self._data.contact.frame[rows, :3], axes))
        return float(
            np.where(axial > feature_size.END, self._faces[others], self._sides[others]).min()
        )

    def _rim_distance(
        self, sensor: AnySensor, rows: NDArray[np.int64], others: NDArray[np.int64]
    ) -> float:
        """Return the minimum distance, m, of the touching faces with edges from the frame."""
        flat = np.asarray(self._has_edges)[others]
        p = self._data.contact.pos[rows[flat]] - self._data.xpos[sensor.body_id]
        xy = (p @ self._data.xmat[sensor.body_id].reshape(3, 3))[:, :2]
        return float(sensor.design.frame.inside(xy).min())
