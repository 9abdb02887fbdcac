"""Detection of every circle in a photograph, with a status for every candidate.

`locate` adds this to `markers.detect`. Touch sensing has known markers: their size is in the sensor
file. They are dark on an evenly lit membrane. A photograph may have a bright window next to the
board, or dots of three pixels. Synthetic images may have no gray edges. So a second search takes
pixels darker than a closing of the image. This "black hat" finds blobs of one size independent of
their surroundings. It runs at several scales. A failed fit is repeated with the blur common to the
others in the image. Rejected candidates are listed with the reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, Ellipses, Image
from mjtactile.sensing.image import candidates, edge_fit, ellipse, markers
from mjtactile.sensing.image.candidates import Candidates
from mjtactile.sensing.image.edge_bands import pairs_within
from mjtactile.sensing.image.ellipse_fit import as_ellipses, fit_candidates, sound
from mjtactile.sensing.image.fit_validation import NOT_ELLIPSE, TEXTURE, implausible, validate_fits
from mjtactile.sensing.image.outline_residual import is_blob, outline_residual
from mjtactile.sensing.settings import DEFAULTS, ExhaustiveDetectionSettings, Settings


@dataclass(frozen=True, eq=False)
class Rejected:
    """M candidates that are no markers: centre (M, 2) and semi-axes (M, 2) px of their outlines,
    and the reason (M,)."""

    center_px: Array
    semi_axes_px: Array
    status: NDArray[np.str_]

    def __len__(self) -> int:
        return len(self.status)

    def records(self) -> list[dict[str, Any]]:
        """Return one JSON-ready record per candidate: `center_px`, `semi_axes_px`, `status`."""
        columns = self.center_px.tolist(), self.semi_axes_px.tolist(), self.status.tolist()
        return [
            {"center_px": center, "semi_axes_px": axes, "status": why}
            for center, axes, why in zip(*columns, strict=True)
        ]


_RING_POINTS = 16  # on a ring around a candidate
_STAIRCASE = 0.08  # residual of the edges of a black and white image, relative to the contrast
NO_REJECTED = Rejected(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, dtype="<U24"))


def detect_thoroughly(
    image: NDArray | Image,
    *,
    polarity: markers.Polarity = "dark",
    min_radius_px: float = 1.5,
    settings: Settings = DEFAULTS,
) -> tuple[Ellipses, Rejected, bool]:
    """Detect markers as `markers.detect`, followed by a second search. Circles that are cut are
    not trusted.

    Returns:
        The circles; all other candidates with the reason for their rejection; and True if the
        outlines of most circles deviate from ellipses, as after processing in the camera.

    Raises:
        InputError: As `markers.detect`.
    """
    grey, edge_noise = _with_grey_edges(markers.grey_image(image), settings.exhaustive_detection)
    s = settings.markers
    markers.check_polarity(polarity)
    eight = markers.eight_bit(grey)
    dark = eight if polarity == "dark" else 255 - eight
    first = candidates.find(dark, min_radius_px, settings.candidates)
    why = implausible(first, min_radius_px, s)
    found = _with_black_hat(first.take(why == ""), dark, min_radius_px, settings)
    textured = _is_textured(grey, found, settings.exhaustive_detection)
    texture = found.take(textured)
    found = found.take(~textured)
    fit = _second_try(
        grey, found, fit_candidates(grey, found, settings), polarity, min_radius_px, settings
    )
    status, keep = validate_fits(fit, found, polarity, grey.shape, min_radius_px, s)
    kept_fit = fit.take(keep)
    kept_status, deformed = _by_outline(grey, kept_fit, status[keep], edge_noise)
    kept = as_ellipses(kept_fit, kept_status)
    outlines = np.concatenate([first.shape[why != ""], texture.shape, found.shape[~keep]])
    centers = np.concatenate([first.center[why != ""], texture.center, found.center[~keep]])
    reasons = np.concatenate([why[why != ""], np.full(len(texture), TEXTURE), status[~keep]])
    return kept, Rejected(centers, ellipse.axes_from_shape(outlines)[0], reasons), deformed


def _by_outline(
    grey: NDArray, fit: edge_fit.EdgeFit, status: NDArray[np.str_], edge_noise: float
) -> tuple[NDArray[np.str_], bool]:
    """Return the status (N,) of each fit after the comparison of all outlines, and True if the
    trusted outlines are deformed."""
    trusted = status == "ok"
    outlines = outline_residual(grey, fit.take(trusted), edge_noise)
    incomplete = outlines.incomplete()
    status = status.copy()
    status[trusted] = np.where(incomplete, NOT_ELLIPSE, "ok")
    amplitude = outlines.amplitude[~incomplete]
    trusted = status == "ok"
    status[trusted] = np.where(is_blob(fit, trusted, amplitude), TEXTURE, "ok")
    return status, outlines.deformed(~incomplete)


def _with_grey_edges(grey: NDArray, s: ExhaustiveDetectionSettings) -> tuple[NDArray, float]:
    """Return `grey`, slightly blurred if it is only black and white (synthetic or thresholded), and
    the residual of its staircase edges, relative to the contrast.

    Without gray levels, nothing shows the edge position between two pixels. Blur of any size leaves
    the same staircase error, 0.05 px of radius at 13-20 px. But with blur the fit detects it, and
    its uncertainty is right.
    """
    cross = cv2.getStructuringElement(cv2.MORPH_RECT, (3, 3))
    low = cv2.erode(grey, cross).astype(np.float32)
    high = cv2.dilate(grey, cross).astype(np.float32)
    step = high - low
    edge = step > 0.5 * float(step.max(initial=0.0))
    level = (grey.astype(np.float32) - low)[edge] / step[edge] if step.any() else np.zeros(0)
    if (
        not level.size
        or ((level > s.grey_levels[0]) & (level < s.grey_levels[1])).mean() > s.grey_fraction
    ):
        return grey, 0.0
    soft = np.rint(cv2.GaussianBlur(grey.astype(np.float32), (0, 0), s.sampled_blur))
    return soft.astype(grey.dtype), _STAIRCASE


def _with_black_hat(
    found: Candidates, dark: NDArray[np.uint8], min_radius_px: float, settings: Settings
) -> Candidates:
    """Return `found` and the additional candidates of the black hat."""
    scale = 1
    more = found
    s = settings.exhaustive_detection
    while min(dark.shape) // scale >= s.min_side:
        if scale == 1:
            small = dark
        else:
            small = cv2.resize(
                dark, (dark.shape[1] // scale, dark.shape[0] // scale), interpolation=cv2.INTER_AREA
            )
        part = candidates.outlines(
            _black_hat(small, settings), max(min_radius_px / scale, 1.5), settings.candidates
        )
        # the center of the first scale x scale pixels is at (scale - 1)/2
        part = Candidates(
            scale * part.center + (scale - 1) / 2, scale * part.shape, scale * part.misfit, part.cut
        )
        more = more.joined(part.take(implausible(part, min_radius_px, settings.markers) == ""))
        scale *= s.scale_step
    new = _new(more, s, settings.edges.max_size_ratio)
    new[: len(found)] = True
    return more.take(new)


def _is_textured(
    grey: NDArray, found: Candidates, s: ExhaustiveDetectionSettings
) -> NDArray[np.bool_]:
    """Return a mask (N,) of the candidates around which gray levels vary as much as at their edge.
    Most candidates in clutter are such, and their fit is costly."""
    soft = cv2.blur(grey, (3, 3))
    levels = []
    for ring in (0.5 * found.shape, found.shape + [s.texture_ring, 0.0, s.texture_ring]):
        points = np.rint(ellipse.boundary(found.center, ring, _RING_POINTS)[0]).astype(np.int64)
        u = np.clip(points[..., 0], 0, grey.shape[1] - 1)
        v = np.clip(points[..., 1], 0, grey.shape[0] - 1)
        opposite = soft[v, u].astype(float).reshape(-1, 2, _RING_POINTS // 2)
        levels.append(np.sort(opposite.mean(axis=1), axis=1))  # free of a gradient of the light
    inside, outside = levels
    middle = _RING_POINTS // 4
    contrast = np.abs(outside[:, middle] - inside[:, middle])
    return outside[:, -2] - outside[:, 1] > s.texture_max * contrast


def _new(
    all_of_them: Candidates, s: ExhaustiveDetectionSettings, larger: float
) -> NDArray[np.bool_]:
    """Return a mask (N,) of the new candidates. A candidate is not new if it repeats an earlier
    one. It is not new either if it is part of one up to `larger` times larger."""
    center = all_of_them.center
    xx, xy, yy = ellipse.inverse_shape(all_of_them.shape).T
    size = np.sqrt(all_of_them.shape[:, 0] * all_of_them.shape[:, 2])
    reach = s.inside_ratio * ellipse.axes_from_shape(all_of_them.shape)[0][:, 0]
    j, i = pairs_within(center, center, np.minimum(reach, size.max(initial=0.0)))
    dx, dy = (center[i] - center[j]).T
    inside = np.hypot(xx[j] * dx + xy[j] * dy, xy[j] * dx + yy[j] * dy) < s.inside_ratio
    ratio = size[j] / size[i]
    part = (ratio > s.same_size_ratio) & (ratio < larger)
    again = (ratio < s.same_size_ratio) & (ratio > 1 / s.same_size_ratio) & (j < i)
    new = np.ones(len(center), dtype=bool)
    new[i[inside & (part | again)]] = False
    return new


def _black_hat(dark: NDArray[np.uint8], settings: Settings) -> NDArray[np.uint8]:
    """Return a binary image of the pixels darker than the closing of the image. The threshold is
    half the maximum difference nearby."""
    s = settings.exhaustive_detection
    soft = cv2.GaussianBlur(dark, (3, 3), 0)
    kernel = cv2.getStructuringElement(cv2.MORPH_RECT, (s.closing_size, s.closing_size))
    hat = cv2.subtract(cv2.morphologyEx(soft, cv2.MORPH_CLOSE, kernel), soft)
    half = cv2.convertScaleAbs(cv2.dilate(hat, kernel), alpha=s.dark_fraction)
    return cv2.compare(
        hat, cv2.max(half, 2 * candidates.noise_margin(soft, settings.candidates)), cv2.CMP_GT
    )


def _second_try(
    grey: NDArray,
    found: Candidates,
    fit: edge_fit.EdgeFit,
    polarity: markers.Polarity,
    min_radius_px: float,
    settings: Settings,
) -> edge_fit.EdgeFit:
    """Return `fit` with the rejected candidates refitted, at a blur near that of the trusted
    markers."""
    status, keep = validate_fits(fit, found, polarity, grey.shape, min_radius_px, settings.markers)
    if keep.all():
        return fit
    good = status == "ok"
    blur = ellipse.upper_median(fit.blur[good]) if good.any() else 0.0
    s = settings.exhaustive_detection
    if blur < s.retry_blur:
        grey = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), s.retry_blur)
        blur = float(np.hypot(blur, s.retry_blur))
    again = edge_fit.fit(
        grey,
        found.center[~keep],
        found.shape[~keep],
        blur=blur,
        blur_sd=s.blur_sd_fraction * blur,
        others=(found.center[keep], found.shape[keep]),
        s=settings.edges,
    )
    return edge_fit.merge(~keep, sound(again), fit.take(keep))
