"""Deviation of outlines from their ellipses, which tells a disc from a part of one.

An ellipse has five parameters. They absorb the harmonics 0 to 2 of an edge's offset along the
outline. A cut, peeled or half-printed disc also has the harmonics 3 to 7, and its fit hides only
the others. Their rms amplitude is compared with three others: with the noise of the pixels, with
the other circles of the image, and with the circle's size. Offsets are areas under profiles across
the edge, so that they need no edge model. Processing in the camera (sharpening, demosaicing,
compression) and defocus deform all outlines of an image alike. This is a property of the image, not
of one circle.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.sensing.image import ellipse
from mjtactile.sensing.image.edge_fit import EdgeFit

_PROFILES = 48
_SAMPLES = 17
_ANGLE = 2 * np.pi * np.arange(_PROFILES) / _PROFILES
_HARMONICS = np.concatenate([[np.cos(k * _ANGLE), np.sin(k * _ANGLE)] for k in range(3, 8)]) * (
    2 / _PROFILES
)
# Whole circles have at most 2.6 times the lower quartile of their photograph (compressed color
# photographs, 2.6 to 15 px), and 0.001 of their radius without camera processing. Circles cut by
# 10 % of the diameter have 0.014 of it, and a size error of 3 standard deviations.
_MIN_PEERS = 5  # minimum number of circles for the typical amplitude of an image
_PEER_QUANTILE = 0.25  # below the median: many circles may be cut
_MAX_RATIO = 4.0  # maximum ratio of a whole circle's amplitude to the typical one
# minimum, as a fraction of the radius: less costs less than 3 standard deviations
_MIN_FRACTION = 0.01
# as a fraction of the radius; real circles have at most 0.031, one of six in textures more
_MAX_FRACTION = 0.04
# Real circles have at most 0.053 (compressed color photographs), printed corners and letters 0.08
# and more, seven of ten blobs of a texture more than 0.07.
# as a fraction of the contrast: residual of the fit beyond the noise of the pixels
_MAX_EXCESS = 0.07
_MIN_DEFORMATION = 0.015  # px; simulated circles have 0.004 to 0.01, photographs 0.026 and more
# Blobs of smoothed noise: of ten that are alike, about one passes the limits above.
_BLOB_RATE = 0.1
_BLOB_FRACTION = 0.03  # of the radius
_ALIKE = 2.5  # maximum ratio of radii, and of contrasts, of blobs of one texture
_MAX_BLOB_PROBABILITY = 0.05  # blobs have 0.2 and more, photographed circles at most 0.004
_MIN_HALF_WIDTH = 2.5  # px; of a profile
_BLURS = 2.5  # half-width of a profile in blurs
_INSIDE = 0.8  # maximum half-width of a profile, relative to the radius
_ROUNDING = 0.3  # standard deviation of rounding to gray levels


@dataclass(frozen=True)
class OutlineResidual:
    """Rms amplitude (N,), px, of harmonics 3 to 7 of each outline; that `expected` (N,) from the
    pixels' noise; and `radius` (N,), the semi-minor axes, px. `excess` (N,) is the residual of each
    fit beyond the noise, relative to the contrast."""

    amplitude: Array
    expected: Array
    radius: Array
    excess: Array

    def incomplete(self) -> NDArray[np.bool_]:
        """Return a mask (N,) of the outlines that deviate from an ellipse by more than noise and
        more than the image's other circles, and of edges that are no edges of a disc."""
        limit = _MAX_RATIO * self.expected
        if len(self.amplitude) >= _MIN_PEERS:
            usual = _MAX_RATIO * np.quantile(self.amplitude, _PEER_QUANTILE)
            limit = np.maximum(limit, np.minimum(usual, _MAX_FRACTION * self.radius))
        deviates = self.amplitude > np.maximum(limit, _MIN_FRACTION * self.radius)
        return deviates | (self.excess > _MAX_EXCESS)

    def deformed(self, use: NDArray[np.bool_]) -> bool:
        """Return True if the typical outline in `use` (N,) deviates from an ellipse by more than
        noise, as in a camera that processes its images."""
        amplitude = self.amplitude[use]
        if len(amplitude) < _MIN_PEERS:
            return False
        ratio = float(np.median(amplitude / self.expected[use]))
        return ratio > _MAX_RATIO and float(np.median(amplitude)) > _MIN_DEFORMATION


def is_blob(fit: EdgeFit, trusted: NDArray[np.bool_], amplitude: Array) -> NDArray[np.bool_]:
    """Return a mask (n,) of the trusted outlines that may be blobs of a texture.

    A texture has many blobs of similar size and contrast, and few of them pass for a circle. Their
    expected number follows from the fits that are refused. Circles that are alike, or an outline
    without a deviation, are evidence against it.

    Args:
        fit: All N fits of an image.
        trusted: Mask (N,) of the n trusted ones.
        amplitude: Their amplitudes (n,), px, of the outline residual.

    Returns:
        True where the probability of a blob exceeds 0.05.
    """
    radius = ellipse.axes_from_shape(fit.shape)[0][:, 1]
    contrast = np.abs(fit.inside - fit.outside)
    size = np.log(np.maximum(np.stack([radius, contrast], axis=1), 1e-3))
    ratio = np.abs(size[trusted, None] - size)  # (n, N, 2)
    alike = (ratio < np.log(_ALIKE)).all(axis=2)
    refused = (alike & ~trusted).sum(axis=1)
    passing = _BLOB_RATE * refused
    circles = (alike & trusted).sum(axis=1) - passing - 2 * np.sqrt(passing)
    rounder = np.minimum(amplitude / (_BLOB_FRACTION * radius[trusted]), 1.0) ** 2
    blobs = rounder * passing
    return blobs / (blobs + np.maximum(circles, 1)) > _MAX_BLOB_PROBABILITY


def outline_residual(grey: NDArray, fit: EdgeFit, edge_noise: float = 0.0) -> OutlineResidual:
    """Measure how far the outlines of N fits in the image `grey` (H, W) deviate from ellipses.

    Args:
        grey: Gray levels.
        fit: Ellipses with the levels inside and outside.
        edge_noise: Additional residual of each edge, relative to its contrast.

    Returns:
        Amplitudes and expected amplitudes of each outline.
    """
    n = len(fit.center)
    radius = np.maximum(ellipse.axes_from_shape(fit.shape)[0][:, 1], 1e-3)
    if not n:
        return OutlineResidual(np.zeros(0), np.zeros(0), radius, np.zeros(0))
    half = np.minimum(np.maximum(_MIN_HALF_WIDTH, _BLURS * fit.blur), _INSIDE * radius)
    points, e = ellipse.boundary(fit.center, fit.shape, _PROFILES)
    p, q, s = (column[:, None] for column in ellipse.inverse_shape(fit.shape).T)
    normals = np.stack([p * e[:, 0] + q * e[:, 1], q * e[:, 0] + s * e[:, 1]], axis=-1)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    across = half[:, None] * np.linspace(-1, 1, _SAMPLES)
    at = points[:, :, None] + normals[:, :, None] * across[:, None, :, None]
    read = cv2.remap(
        grey if grey.dtype == np.uint8 else grey.astype(np.float32),
        at.reshape(n, _PROFILES * _SAMPLES, 2).astype(np.float32),
        None,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    ).reshape(n, _PROFILES, _SAMPLES)
    contrast = fit.inside - fit.outside
    contrast = np.where(np.abs(contrast) < 1, -1.0, contrast)
    total = read.sum(axis=2, dtype=float) - _SAMPLES * fit.outside[:, None]
    offset = total * (2 * half / (_SAMPLES - 1) / contrast)[:, None]
    amplitude = np.sqrt(np.square(offset @ _HARMONICS.T).mean(axis=1))
    perimeter = 2 * np.pi * np.sqrt(np.square(fit.shape).sum(axis=1) / 2)
    # independent pixels in the band of a profile; 2/perimeter is the variance of a harmonic
    noise = _noise(grey)
    expected = noise / np.abs(contrast) * np.sqrt(2 * half * 2 / perimeter)
    relative = (np.square(fit.residual) - noise**2) / np.square(contrast) - edge_noise**2
    return OutlineResidual(amplitude, expected, radius, np.sqrt(np.maximum(relative, 0.0)))


def _noise(grey: NDArray) -> float:
    """Return the standard deviation of the pixel noise, gray levels. It comes from second
    differences along rows, which are free of slow changes of the light."""
    rows = grey[:: max(1, grey.shape[0] // 32)].astype(np.float32)
    second = np.abs(rows[:, 2:] - 2 * rows[:, 1:-1] + rows[:, :-2])
    plain = second[second <= 3 * np.median(second) + 1]  # no edges
    return max(float(np.sqrt(np.square(plain, dtype=float).mean() / 6)), _ROUNDING)
