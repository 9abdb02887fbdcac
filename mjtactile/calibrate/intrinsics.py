"""Fit of a camera's intrinsics to views of a flat board, for each lens model.

OpenCV fits the models; pixel centers are at integers, as in docs/reference/conventions.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.lens import MODELS, PLUMB_BOB, Lens
from mjtactile.core.types import Array

Points = Sequence[tuple[Array, Array]]
"""Points (N, 3), m, on the board and their pixels (N, 2), of each view."""
_FISHEYE = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
_FLAGS = {PLUMB_BOB: 0, "rational_polynomial": cv2.CALIB_RATIONAL_MODEL}
"""Flags of `cv2.calibrateCamera` for a lens model."""
FITTED = (*_FLAGS, "equidistant")
"""Lens models that OpenCV fits; the last as a fisheye."""


@dataclass(frozen=True)
class LensFit:
    """Options of the fit.

    Attributes:
        model: Lens model.
        k3: True to fit the sixth order of plumb_bob too, for wide lenses.
    """

    model: str = PLUMB_BOB
    k3: bool = False

    def __post_init__(self) -> None:
        if self.model not in FITTED:
            raise InputError(f"{self.model!r} cannot be fitted", field="--lens", choices=FITTED)
        if self.k3 and self.model != PLUMB_BOB:
            raise InputError(f"{self.model} has no optional k3", field="--k3")


DEFAULT = LensFit()


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """Fitted intrinsics.

    `K` (3, 3) px; `sd` of fx, fy, cx, cy and of each coefficient; `rotations` of the board
    (rotation vectors) in each view; residuals `rms` and `view_rms` (views,), px.
    """

    K: Array
    lens: Lens
    sd: Array
    rotations: Sequence[Array]
    rms: float
    view_rms: Array

    def pose_of(self, corners: Array, uv: Array) -> tuple[Array, Array]:
        """Return the rotation vector and the translation, m, of a board whose `corners` (N, 3), m,
        appear at `uv` (N, 2) px."""
        if self.lens.model in _FLAGS:
            _, rotation, shift = cv2.solvePnP(corners, uv, self.K, self._k)
            return rotation, shift
        xy = self.lens.undistort((uv - self.K[:2, 2]) / self.K[[0, 1], [0, 1]])
        _, rotation, shift = cv2.solvePnP(corners, xy, np.eye(3), None)
        return rotation, shift

    def project(self, corners: Array, rotation: Array, shift: Array) -> Array:
        """Return the pixels (N, 2) of a board's points (N, 3) m at a pose."""
        if self.lens.model in _FLAGS:
            return cv2.projectPoints(corners, rotation, shift, self.K, self._k)[0].reshape(-1, 2)
        p = corners @ cv2.Rodrigues(rotation)[0].T + np.ravel(shift)
        return self.lens.distort(p[:, :2] / p[:, 2:]) * self.K[[0, 1], [0, 1]] + self.K[:2, 2]

    @property
    def _k(self) -> Array:
        return np.array(self.lens.coefficients)


def fit_intrinsics(points: Points, size: tuple[int, int], options: LensFit) -> Intrinsics:
    """Fit the intrinsics of a camera.

    Args:
        points: Points of each view.
        size: Width and height of the image, px.
        options: Lens model and its free coefficients.

    Returns:
        The fit.

    Raises:
        InputError: No camera fits.
    """
    try:
        if options.model in _FLAGS:
            return _fit_polynomial(points, size, options)
        return _fit_fisheye(points, size, options)
    except (cv2.error, np.linalg.LinAlgError) as error:
        message = f"no camera model fits these images: {getattr(error, 'err', error)}"
        raise InputError(message, field="pictures") from error


def _fit_polynomial(points: Points, size: tuple[int, int], options: LensFit) -> Intrinsics:
    count = len(MODELS[options.model].coefficients)
    flags = _FLAGS[options.model]
    if options.model == PLUMB_BOB and not options.k3:
        flags |= cv2.CALIB_FIX_K3
    rms, K, k, rotations, _, sd, _, view_rms = cv2.calibrateCameraExtended(
        [corners.astype(np.float32) for corners, _ in points],
        [uv.astype(np.float32) for _, uv in points],
        size,
        np.eye(3),
        np.zeros(count),
        flags=flags,
    )
    lens = Lens(options.model, tuple(np.ravel(k)[:count].tolist()))
    return Intrinsics(K, lens, np.ravel(sd)[: 4 + count], rotations, float(rms), np.ravel(view_rms))


def _fit_fisheye(points: Points, size: tuple[int, int], options: LensFit) -> Intrinsics:
    count = len(MODELS[options.model].coefficients)
    _, K, k, rotations, shifts = cv2.fisheye.calibrate(
        [np.ascontiguousarray(corners[None], dtype=float) for corners, _ in points],
        [np.ascontiguousarray(uv[None], dtype=float) for _, uv in points],
        size,
        np.eye(3),
        np.zeros(count),
        flags=_FISHEYE,
    )
    squares = []
    information = np.zeros((4 + count, 4 + count))
    for (corners, uv), rotation, shift in zip(points, rotations, shifts, strict=True):
        projected, J = cv2.fisheye.projectPoints(
            np.ascontiguousarray(corners[None], dtype=float), rotation, shift, K, k
        )
        squares.append(((projected[0] - uv) ** 2).sum(axis=1))
        kept_columns = J[:, : 4 + count]
        pose = J[:, 4 + count : 10 + count]
        left = kept_columns - pose @ np.linalg.lstsq(pose, kept_columns, rcond=None)[0]
        information += left.T @ left
    residual = np.concatenate(squares)
    free = 2 * len(residual) - 4 - count - 6 * len(points)
    cov = np.linalg.inv(information) * residual.sum() / max(free, 1)
    lens = Lens(options.model, tuple(np.ravel(k)[:count].tolist()))
    return Intrinsics(
        K,
        lens,
        np.sqrt(np.diagonal(cov)),
        rotations,
        float(np.sqrt(residual.mean())),
        np.array([np.sqrt(square.mean()) for square in squares]),
    )
