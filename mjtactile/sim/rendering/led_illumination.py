"""Illumination of the membrane by the LEDs without obstruction, on a smooth bubble."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core import optics
from mjtactile.core.design import SensorDesign
from mjtactile.core.optics import Camera
from mjtactile.core.types import Array

BLOCK_PX = 16
"""Block size for which the light is computed once. The error is below 0.05 DN."""

Floats = NDArray[np.float32]


def block_slopes(camera: Camera, block: int) -> Array:
    """Return slopes x/z, y/z (nv, nu, 2) in C of the rays, in air, through pixel blocks."""
    nu = -(-camera.width // block)
    nv = -(-camera.height // block)
    u = (np.arange(nu) + 0.5) * (camera.width / nu) - 0.5
    v = (np.arange(nv) + 0.5) * (camera.height / nv) - 0.5
    ray = optics.unproject(camera, np.stack(np.meshgrid(u, v), axis=-1))
    return np.nan_to_num(ray[..., :2] / ray[..., 2:])


class Light:
    """Illumination of the membrane by a ring of LEDs around the camera.

    The model is the inverse-square law and two cosines. Without LEDs the light is uniform. The
    field is 1 in the center of the flat membrane and 1 - vignetting at the corners. Heights between
    the markers are those of the bubble (1 - (2x/L)^2) (1 - (2y/W)^2) (a + bx + cy), fitted to the
    markers.
    """

    def __init__(self, design: SensorDesign, camera: Camera):
        self._frame = design.frame
        self._falloff = design.leds.vignetting
        self._size = (camera.width, camera.height)
        self._xy = block_slopes(camera, BLOCK_PX) * design.camera.distance
        self._even = design.leds.count == 0
        angle = (np.arange(max(design.leds.count, 1)) + 0.5) * (
            2 * np.pi / max(design.leds.count, 1)
        )
        self._leds = design.leds.ring_radius * np.column_stack([np.cos(angle), np.sin(angle)])
        self._distance = design.camera.distance
        x = design.frame.length / 2
        y = design.frame.width / 2
        at_center, corner = self._irradiance(
            self._lateral_squared(np.array([[0.0, 0.0], [x, y]])), np.zeros(2)
        )
        self._middle = at_center
        self._loss = 1 - corner / at_center
        # of the blocks
        self._bubbles = self._bubble(self._xy)
        self._asides = self._lateral_squared(self._xy)

    def field(self, p_SM: Array) -> Floats:
        """Return the relative light (H, W) on a membrane with markers at `p_SM` (N, 3), m."""
        if self._even:
            return np.ones(self._size[::-1], np.float32)
        fraction = self._irradiance(self._asides, self._heights(p_SM)) / self._middle
        field = 1 - self._falloff * (1 - fraction) / self._loss
        return cv2.resize(
            np.maximum(field, 0.0).astype(np.float32), self._size, interpolation=cv2.INTER_LINEAR
        )

    def at(self, p_SM: Array) -> Array:
        """Return the relative light (N,) at the markers."""
        if self._even:
            return np.ones(len(p_SM))
        fraction = self._irradiance(self._lateral_squared(p_SM[:, :2]), p_SM[:, 2]) / self._middle
        return np.maximum(1 - self._falloff * (1 - fraction) / self._loss, 0.0)

    def _lateral_squared(self, xy: Array) -> Array:
        """Return the squared lateral distances (n, ...), m^2, of positions (..., 2) from the
        LEDs."""
        return ((self._leds.reshape(-1, *(1,) * (xy.ndim - 1), 2) - xy) ** 2).sum(axis=-1)

    def _irradiance(self, aside: Array, z: Array) -> Array:
        """Return the LEDs' irradiance at squared lateral distances and heights `z` (...)."""
        h2 = (self._distance + z) ** 2
        return h2 * ((aside + h2) ** -2.0).sum(axis=0)

    def _heights(self, p_SM: Array) -> Array:
        p_SM = p_SM[np.isfinite(p_SM).all(axis=1)]
        basis = self._bubble(p_SM[:, :2])
        ridge = (
            1e-6 * max(len(p_SM), 1) * np.diag([1.0, self._frame.length**2, self._frame.width**2])
        )
        weights = np.linalg.solve(basis.T @ basis + ridge, basis.T @ p_SM[:, 2])
        return self._bubbles @ weights

    def _bubble(self, xy: Array) -> Array:
        x = xy[..., 0]
        y = xy[..., 1]
        half_x = self._frame.length / 2
        half_y = self._frame.width / 2
        if self._frame.outline is None:
            bubble = np.clip(1 - (x / half_x) ** 2, 0, 1) * np.clip(1 - (y / half_y) ** 2, 0, 1)
        else:
            bubble = np.clip(1 - (x / half_x) ** 2 - (y / half_y) ** 2, 0, 1)
        return np.stack([bubble, bubble * x, bubble * y], axis=-1)
