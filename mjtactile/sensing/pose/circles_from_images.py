"""Circle poses from image files: the part of `mjtactile detect-circles` without side effects."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjtactile.core import optics
from mjtactile.core.errors import InputError
from mjtactile.core.image_decoding import decode, read_file
from mjtactile.core.sensor_parts import CameraDesign
from mjtactile.core.signature_checks import above, validated, within
from mjtactile.core.types import Array, CirclePoses, Ellipses, Image
from mjtactile.sensing.image.exhaustive_detection import NO_REJECTED, Rejected, detect_thoroughly
from mjtactile.sensing.image.gamma import UNKNOWN, Gamma, estimate_gamma, linear_light
from mjtactile.sensing.image.markers import Polarity, grey_image, is_overexposed
from mjtactile.sensing.pose.circles import estimate_poses, pose_covariances
from mjtactile.sensing.pose.neighbor_smoothing import smooth_aspect_ratio
from mjtactile.sensing.pose.pose_disambiguation import prefer
from mjtactile.sensing.settings import DEFAULTS, Settings
from mjtactile.sensing.surface.depth_smoothing import SharedDepth, agree_on_depth

Neighbours = Literal["auto", "always", "never"]
# standard deviation of log gamma of a camera without known gamma: 1 to 2.2
_UNKNOWN_LOG_GAMMA = 0.4
_GREY = np.full((1, 3), 1 / 3)
GAMMAS = (0.2, 5.0)  # range of a requested gamma
NOT_BEYOND_GLASS = "nearer than the glass"
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp")


def load_image(path: str | Path) -> NDArray:
    """Read an image file: (H, W) or (H, W, 3) BGR, uint8 or uint16, as stored. Raises InputError
    for a missing, unreadable or corrupt file."""
    path = Path(path)
    pixels = decode(read_file(path), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise InputError("corrupt, too large, or not an image", source=path, choices=IMAGE_SUFFIXES)
    if pixels.ndim == 3 and pixels.shape[2] == 4:
        pixels = pixels[..., :3]
    if pixels.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{pixels.dtype} pixels", source=path, choices=("8 bit", "16 bit"))
    return pixels


@dataclass(frozen=True)
class DetectedCircles:
    """Circles of one image.

    - `ellipses` and `poses`: of the two poses of each circle, the more likely is first.
    - `cov_p_alt` (N, 3, 3): covariance of the other pose's center, m^2.
    - `sure` (N,): probability that the first pose is right.
    - `shared`: quantities smoothed over neighbors ("elongation", "depth"; empty: each circle
      alone).
    - `rejected`: candidates that are not circles, each with a reason.
    - `overexposed`: True if the circles' bright side is clipped.
    - `assumed`: assumed gamma of the camera; `gamma`: its estimate from the circles.
    - `nonlinear`: True if they clearly differ.
    - `deformed`: True if most outlines deviate from ellipses by more than noise, as after
      processing in the camera.
    """

    ellipses: Ellipses
    poses: CirclePoses
    cov_p_alt: Array
    sure: Array
    shared: tuple[str, ...]
    rejected: Rejected = NO_REJECTED
    overexposed: bool = False
    assumed: float = 1.0
    gamma: Gamma = UNKNOWN
    nonlinear: bool = False
    deformed: bool = False

    @property
    def status(self) -> str:
        """ "ok", or the reason why the image has no usable circle."""
        if (self.poses.status == "ok").any():
            return "ok"
        if len(self.poses):
            return f"none of {len(self.poses)} circles can be trusted"
        return "no circle found"


@validated(radius=above(0), min_radius_px=above(0), gamma=within(*GAMMAS))
def detect_circles(
    image: NDArray | Image,
    camera: optics.Camera | CameraDesign,
    radius: ArrayLike,
    *,
    polarity: Polarity = "dark",
    min_radius_px: float = 1.5,
    neighbours: Neighbours = "auto",
    gamma: float | Literal["auto"] = 1.0,
    settings: Settings | None = None,
) -> DetectedCircles:
    """Find circles of a known radius in one image, and their poses.

    If the bright side of the edges is clipped, all dark circles appear smaller by tenths of a
    pixel. The image does not show this error, so the covariance includes it.

    Args:
        image: Gray levels or colors (H, W) or (H, W, 3), or an `Image`.
        camera: Lens and glass.
        radius: Circle radius, m, one for all or one for each circle.
        polarity: Circles "dark" on a bright background, or "bright".
        min_radius_px: Minimum radius to search for.
        neighbours: Smoothing over 40 or more circles that clearly lie on one smooth surface. "auto"
            smooths elongation, and depth if the circles are small and all of one radius. "always"
            smooths depth at any size; "never" estimates each alone. Circles that disagree are not
            smoothed.
        gamma: Gamma of a camera whose gray levels are light to the power of 1/gamma. "auto" uses a
            clear estimate from the circles. The covariance then includes its uncertainty. If the
            estimate clearly differs from the given value, it includes the difference.
        settings: Settings of the stages; None: the defaults.

    Returns:
        Ellipses and both poses of each circle with covariances, and every other candidate with the
        reason for its rejection.

    Raises:
        InputError: The image, the radius, or an option is invalid, or the image has another size
            than the camera.
    """
    _check_options(neighbours, gamma)
    settings = DEFAULTS if settings is None else settings
    grey = grey_image(plain_grey(image))
    if mismatch := camera.size_mismatch(grey):
        raise InputError(mismatch, source="detect-circles", field="image")
    assumed = 1.0 if gamma == "auto" else float(gamma)
    search = partial(
        detect_thoroughly, polarity=polarity, min_radius_px=min_radius_px, settings=settings
    )
    ellipses, rejected, deformed = search(linear_light(grey, assumed))
    overexposed = is_overexposed(grey, ellipses, polarity, settings.locate)
    reported = UNKNOWN if overexposed else estimate_gamma(grey, ellipses, settings)
    if gamma == "auto" and reported.contradicts(assumed, settings.gamma):
        assumed = reported.value
        ellipses, rejected, deformed = search(linear_light(grey, assumed))
    nonlinear = reported.contradicts(assumed, settings.gamma)
    found = replace(
        _together(ellipses, camera, radius, neighbours, settings),
        rejected=rejected,
        overexposed=overexposed,
        assumed=assumed,
        gamma=reported,
        nonlinear=nonlinear,
        deformed=deformed,
    )
    return _with_size_uncertainty(found, settings)


def _check_options(neighbours: str, gamma: object) -> None:
    """Raise InputError for an invalid option."""
    if neighbours not in ("auto", "always", "never"):
        raise InputError(
            f"{neighbours!r}",
            source="detect-circles",
            field="neighbours",
            choices=("auto", "always", "never"),
        )
    low, high = GAMMAS
    if gamma != "auto" and not (isinstance(gamma, int | float) and low <= gamma <= high):
        raise InputError(
            f"{gamma!r}",
            source="detect-circles",
            field="gamma",
            choices=("auto", f"{low:g} to {high:g}"),
        )


def _with_size_uncertainty(found: DetectedCircles, settings: Settings) -> DetectedCircles:
    """Return `found` with the covariance of a size error from clipping or an unknown gamma. An
    image with deformed outlines is not linear light; without an estimate, its gamma is unknown."""
    size_sd = settings.locate.size_sd if found.overexposed else 0.0
    if found.assumed == found.gamma.value or found.gamma.deviates(found.assumed, settings.gamma):
        size_sd = np.hypot(size_sd, found.gamma.size_uncertainty(found.assumed, settings.gamma))
    elif found.deformed and not found.overexposed:
        size_sd = _UNKNOWN_LOG_GAMMA * settings.gamma.size_per_log
    if not size_sd:
        return found
    size_cov = _size_covariance(found.poses, found.ellipses, float(size_sd))
    return replace(
        found,
        poses=replace(found.poses, cov_p=found.poses.cov_p + size_cov),
        cov_p_alt=found.cov_p_alt + size_cov,
    )


def _together(
    ellipses: Ellipses,
    camera: optics.Camera | CameraDesign,
    radius: ArrayLike,
    neighbours: Neighbours,
    settings: Settings,
) -> DetectedCircles:
    """Estimate the poses of the circles, with shared information between neighbors as `neighbours`
    allows."""
    camera = camera if isinstance(camera, optics.Camera) else optics.Camera.from_design(camera)
    poses = estimate_poses(ellipses, camera, radius)
    if neighbours == "never":
        return _preferred(ellipses, camera, poses, settings)
    alike = smooth_aspect_ratio(ellipses, settings.neighbor_smoothing)
    shared = () if alike is ellipses else ("elongation",)
    good = ellipses.status == "ok"
    small = (
        good.any() and np.median(ellipses.semi_axes_px[good, 1]) < settings.locate.min_shared_radius
    )
    use_neighbors = (small or neighbours == "always") and np.ptp(radius) == 0
    depth = agree_on_depth(poses, settings.smoothness) if use_neighbors else None
    return _preferred(
        alike,
        camera,
        estimate_poses(alike, camera, radius) if shared else poses,
        settings,
        shared if depth is None else (*shared, "depth"),
        depth,
    )


def _preferred(
    ellipses: Ellipses,
    camera: optics.Camera,
    poses: CirclePoses,
    settings: Settings,
    shared: tuple[str, ...] = (),
    depth: SharedDepth | None = None,
) -> DetectedCircles:
    """Return the poses at the shared `depth`, with the likelier one of each circle first."""
    _, cov_n = pose_covariances(ellipses, camera, poses.p_CM, poses.n_C)
    cov_p_alt, cov_n_alt = pose_covariances(ellipses, camera, poses.p_CM_alt, poses.n_C_alt)
    depth_sd = None
    if depth is not None:
        poses, cov_p_alt = depth.along_rays(poses, cov_p_alt)
        depth_sd = depth.relative_sds(len(poses))
    better, cov_p_alt, sure = prefer(
        poses,
        cov_p_alt,
        np.stack([cov_n, cov_n_alt]),
        settings.pose_disambiguation,
        depth_sd=depth_sd,
    )
    # NaN for a position that is not visible through the glass
    uv_px = optics.project(camera, better.p_CM)
    inside = (better.status == "ok") & ~np.isfinite(uv_px).all(axis=1)
    better = replace(better, uv_px=uv_px, status=np.where(inside, NOT_BEYOND_GLASS, better.status))
    return DetectedCircles(ellipses, better, cov_p_alt, sure, shared)


def _size_covariance(poses: CirclePoses, ellipses: Ellipses, size_sd: float) -> Array:
    """Return the covariance of the centers (N, 3, 3), m^2, due to a size error of `size_sd` px as
    depth."""
    along = poses.p_CM * (size_sd / ellipses.semi_axes_px[:, :1])
    return along[:, :, None] * along[:, None]


def locate(
    image: NDArray | Image,
    camera: optics.Camera | CameraDesign,
    radius: ArrayLike,
    *,
    polarity: Polarity = "dark",
    min_radius_px: float = 1.5,
    neighbours: Neighbours = "auto",
) -> list[dict[str, Any]]:
    """Detect circles and return them as JSON-ready records. See `detect_circles`,
    `circles_to_records`."""
    found = detect_circles(
        image, camera, radius, polarity=polarity, min_radius_px=min_radius_px, neighbours=neighbours
    )
    return circles_to_records(found)


def plain_grey(image: NDArray | Image) -> NDArray | Image:
    """Convert a color image to gray (mean of the channels) in one pass. Any other input is passed
    on for `detect` to check."""
    if (
        isinstance(image, np.ndarray)
        and image.ndim == 3
        and image.shape[2] == 3
        and image.dtype in (np.uint8, np.uint16)
    ):
        return cv2.transform(image, _GREY)
    return image


@validated()
def circles_to_records(found: DetectedCircles) -> list[dict[str, Any]]:
    """Make plain records of the circles, for JSON.

    Args:
        found: Result of `detect_circles`.

    Returns:
        One record per marker: `uv_px`, `ellipse_px`; `center_mm`, `cov_center_mm2`, `normal` of the
        preferred pose with its `preferred_probability`; `center_alt_mm`, `cov_center_alt_mm2`,
        `normal_alt` of the other; `status`. Lengths are in mm, angles in degrees; non-finite values
        are None.
    """
    ellipses = found.ellipses
    poses = found.poses
    return [
        {
            "uv_px": _plain(poses.uv_px[i]),
            "ellipse_px": {
                "center": _plain(ellipses.center_px[i]),
                "semi_axes": _plain(ellipses.semi_axes_px[i]),
                "angle_deg": _plain(np.rad2deg(ellipses.angle[i])),
            },
            "center_mm": _plain(poses.p_CM[i] * 1e3),
            "cov_center_mm2": _plain(poses.cov_p[i] * 1e6),
            "normal": _plain(poses.n_C[i]),
            "preferred_probability": _plain(found.sure[i]),
            "center_alt_mm": _plain(poses.p_CM_alt[i] * 1e3),
            "cov_center_alt_mm2": _plain(found.cov_p_alt[i] * 1e6),
            "normal_alt": _plain(poses.n_C_alt[i]),
            "status": str(poses.status[i]),
        }
        for i in range(len(poses))
    ]


def _plain(value: ArrayLike) -> Any:
    array = np.asarray(value, dtype=float)
    if array.ndim == 0:
        return float(array) if np.isfinite(array) else None
    return [_plain(part) for part in array]
