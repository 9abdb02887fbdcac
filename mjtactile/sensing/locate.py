"""Circles in image files: read a file, find the circles, say where each is. The pure part of `mjtactile locate`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjtactile import optics
from mjtactile.design import CameraDesign
from mjtactile.errors import InputError
from mjtactile.sensing.consensus import share_elongation
from mjtactile.sensing.markers import Polarity, detect
from mjtactile.sensing.pose import estimate_poses
from mjtactile.types import CirclePoses, Ellipses, Image

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp")


def load_image(path: str | Path) -> NDArray:
    """Read an image file: (H, W) or (H, W, 3) BGR, uint8 or uint16, as stored.

    Raises InputError for a missing, unreadable or corrupt file.
    """
    path = Path(path)
    try:
        data = np.frombuffer(path.read_bytes(), np.uint8)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=path) from error
    try:
        pixels = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    except cv2.error:
        pixels = None
    if pixels is None:
        raise InputError("corrupt, or not an image", source=path, choices=IMAGE_SUFFIXES)
    if pixels.ndim == 3 and pixels.shape[2] == 4:
        pixels = pixels[..., :3]
    if pixels.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{pixels.dtype} pixels", source=path, choices=("8 bit", "16 bit"))
    return pixels


def locate(image: NDArray | Image, camera: optics.Camera | CameraDesign, radius: ArrayLike, *,
           polarity: Polarity = "dark", min_radius_px: float = 1.5, share: bool = True) -> list[dict[str, Any]]:
    """Circles of `radius` m in one image as JSON-ready records; see `marker_records`.

    `share`: circles that plainly lie on one smooth surface share their elongation (see `consensus`).
    """
    ellipses = detect(image, camera, polarity=polarity, min_radius_px=min_radius_px)
    if share:
        ellipses = share_elongation(ellipses)
    return marker_records(ellipses, estimate_poses(ellipses, camera, radius))


def marker_records(ellipses: Ellipses, poses: CirclePoses) -> list[dict[str, Any]]:
    """One record per marker: `uv_px`, `ellipse_px`, `center_mm`, `normal`, `normal_alt`, `cov_center_mm2`, `status`.

    Units at this edge: px, mm, degrees; numbers that are not finite become None.
    """
    records = []
    for i in range(len(poses)):
        records.append({
            "uv_px": _plain(poses.uv_px[i]),
            "ellipse_px": {"center": _plain(ellipses.center_px[i]), "semi_axes": _plain(ellipses.semi_axes_px[i]),
                           "angle_deg": _plain(np.rad2deg(ellipses.angle[i]))},
            "center_mm": _plain(poses.p_CM[i] * 1e3),
            "normal": _plain(poses.n_C[i]),
            "normal_alt": _plain(poses.n_C_alt[i]),
            "cov_center_mm2": _plain(poses.cov_p[i] * 1e6),
            "status": str(poses.status[i]),
        })  # fmt: skip
    return records


def _plain(value: ArrayLike) -> Any:
    array = np.asarray(value, dtype=float)
    if array.ndim == 0:
        return float(array) if np.isfinite(array) else None
    return [_plain(part) for part in array]
