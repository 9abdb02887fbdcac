"""Camera intrinsics from images of a ChArUco board, with checks of the calibration quality.

`mjtactile.calibrate.intrinsics` fits the model. This module adds three checks. Outlier views are
dropped. The camera is tested on views that were not used in the fit. A result with insufficient
data (no tilt, image corners not covered, few views) is refused with the reason.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.calibrate.intrinsics import DEFAULT, LensFit, Points, fit_intrinsics
from mjtactile.core import camera_file
from mjtactile.core.calibration_parts import CalibrationMetadata, LensCalibration
from mjtactile.core.errors import InputError
from mjtactile.core.lens import Lens
from mjtactile.core.types import Array

# each adds 6 unknowns (its pose) to the camera's 8, and some 50 to 100 measured values
VIEWS_MIN = 8
CORNERS_MIN = 12
# sub-pixel corners of a flat board in focus leave 0.05 to 0.3 px
RMS_MAX_PX = 0.5
HOLDOUT_MAX_PX = 0.7
# maximum relative sd of the focal length, to which depths and forces are proportional
FOCAL_SD_MAX = 0.005
# minimum tilt: a frontal board separates focal length from distance only by perspective
TILT_MIN_DEG = 15.0
TILTED_MIN = 3
COVERAGE_MIN = 0.6  # fraction of the image's 8 x 6 cells; the distortion is extrapolated elsewhere
_CELLS = (8, 6)
_OUTLIER = 3.0  # maximum residual of a view, relative to the median view


@dataclass(frozen=True)
class Board:
    """ChArUco board: numbers of squares, side lengths and marker dictionary.

    `columns` and `rows` count the squares in x and y. `square` and `marker` are side lengths, m.
    """

    columns: int = 9
    rows: int = 7
    square: float = 5e-3
    marker: float = 3.75e-3
    dictionary: str = "4X4_50"

    def make(self) -> Any:
        """Return OpenCV's board. Raises InputError for an impossible one."""
        names = sorted(
            name.removeprefix("DICT_") for name in dir(cv2.aruco) if name.startswith("DICT_")
        )
        if self.dictionary not in names:
            raise InputError(
                f"unknown dictionary {self.dictionary!r}", field="--dictionary", choices=names
            )
        dictionary = cv2.aruco.getPredefinedDictionary(
            getattr(cv2.aruco, f"DICT_{self.dictionary}")
        )
        if not 0 < self.marker < self.square:
            raise InputError(
                f"markers of {1e3 * self.marker:g} mm do not fit in squares of "
                f"{1e3 * self.square:g} mm",
                field="--marker-mm",
            )
        if self.columns * self.rows // 2 > len(dictionary.bytesList):
            raise InputError(
                f"a board of {self.columns} x {self.rows} squares needs more markers than the "
                "dictionary has",
                field="--board",
            )
        return cv2.aruco.CharucoBoard(
            (self.columns, self.rows), self.square, self.marker, dictionary
        )

    def render(self, pixels_per_square: int = 120) -> NDArray[np.uint8]:
        """Render the board as an image to print, with a quiet zone of half a square."""
        size = (self.columns + 1) * pixels_per_square, (self.rows + 1) * pixels_per_square
        return self.make().generateImage(size, marginSize=pixels_per_square // 2)


@dataclass(frozen=True, eq=False)
class BoardView:
    """Corners detected in one image: `ids` (N,) into the board's corners, `uv` (N, 2) px."""

    name: str
    ids: NDArray[np.int32]
    uv: Array


class Finder(Protocol):
    """Detector of a calibration target, with the positions of its points on the target."""

    def find(self, name: str, gray: NDArray[np.uint8]) -> BoardView | None: ...

    def corners(self, view: BoardView) -> Array: ...


class BoardFinder:
    """Detector of a board's corners in images."""

    def __init__(self, board: Board):
        self.board = board.make()
        self._detector = cv2.aruco.CharucoDetector(self.board)

    def find(self, name: str, gray: NDArray[np.uint8]) -> BoardView | None:
        """Detect the corners; None for fewer than CORNERS_MIN."""
        corners, ids, _, _ = self._detector.detectBoard(gray)
        if ids is None or len(ids) < CORNERS_MIN:
            return None
        return BoardView(
            name, ids.reshape(-1).astype(np.int32), corners.reshape(-1, 2).astype(float)
        )

    def corners(self, view: BoardView) -> Array:
        """Return the positions (N, 3), m, of the view's corners on the board."""
        return np.asarray(self.board.getChessboardCorners(), dtype=float)[view.ids]


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """Fitted camera: `K` (3, 3), `lens`, and `sd` of fx, fy, cx, cy and of the coefficients.
    Residuals are in px.

    `view_rms` is the residual of each image. `dropped` lists the outlier images. `holdout_px` is
    the rms in images that were not fitted. `coverage` is the fraction of the image that contained
    corners. `tilts` are the board's tilts in each view, deg. `reasons` lists why the calibration is
    refused.
    """

    size: tuple[int, int]
    K: Array
    lens: Lens
    sd: Array
    rms: float
    view_rms: dict[str, float]
    dropped: tuple[str, ...]
    holdout_px: float
    coverage: float
    tilts: Array
    reasons: tuple[str, ...]


def calibrate_camera(
    finder: Finder, views: Sequence[BoardView], size: tuple[int, int], options: LensFit = DEFAULT
) -> CameraCalibration:
    """Fit a camera of `size` (width, height) px with the lens of `options`.

    Raises InputError for fewer than three views.
    """
    if len(views) < 3:
        raise InputError(
            f"the board was found in {len(views)} images; at least {VIEWS_MIN} are needed (15 "
            "to 30 recommended)",
            field="pictures",
        )
    fit = fit_intrinsics(_points(finder, views), size, options)
    keep = [
        view
        for view, rms in zip(views, fit.view_rms, strict=True)
        if rms <= max(_OUTLIER * float(np.median(fit.view_rms)), 0.2)
    ]
    dropped = tuple(view.name for view in views if view not in keep)
    if dropped and len(keep) >= 3:
        views = keep
        fit = fit_intrinsics(_points(finder, keep), size, options)
    tilts = np.array([_tilt(rotation) for rotation in fit.rotations])
    coverage = _coverage(views, size)
    holdout = _holdout(finder, views, size, options)
    result = CameraCalibration(
        size,
        fit.K,
        fit.lens,
        fit.sd,
        fit.rms,
        {v.name: float(r) for v, r in zip(views, fit.view_rms, strict=True)},
        dropped,
        holdout,
        coverage,
        tilts,
        (),
    )
    return replace(result, reasons=tuple(_refusals(result)))


def _refusals(c: CameraCalibration) -> list[str]:
    """Return the reasons to refuse a calibration; empty for a good one."""
    focal_sd = float(np.max(c.sd[:2] / np.diag(c.K)[:2]))
    tilted = int(np.sum(c.tilts > TILT_MIN_DEG))
    checks = {
        (
            f"only {len(c.view_rms)} images are usable; at least {VIEWS_MIN} are needed: take more"
        ): len(c.view_rms) >= VIEWS_MIN,
        (
            f"{len(c.dropped)} images are inconsistent with the others: check that the board "
            "is flat, the lens is fixed and --square-mm is right"
        ): len(c.dropped) <= len(c.view_rms) / 4,
        (
            f"the corners deviate by {c.rms:.2f} px rms (allowed: {RMS_MAX_PX:g}): check "
            "focus, motion blur and flatness of the board"
        ): c.rms <= RMS_MAX_PX,
        (
            f"in held-out images the corners deviate by {c.holdout_px:.2f} px rms (allowed: "
            f"{HOLDOUT_MAX_PX:g}): take more images that cover the whole view"
        ): c.holdout_px <= HOLDOUT_MAX_PX,
        (
            f"the focal length has a standard deviation of {100 * focal_sd:.1f} % (allowed: "
            f"{100 * FOCAL_SD_MAX:g} %): tilt the board more"
        ): focal_sd <= FOCAL_SD_MAX,
        (
            f"the board is tilted by more than {TILT_MIN_DEG:g} degrees in {tilted} images; "
            f"at least {TILTED_MIN} are needed: tilt it left, right, up and down"
        ): tilted >= TILTED_MIN,
        (
            f"the corners cover {100 * c.coverage:.0f} % of the image; at least "
            f"{100 * COVERAGE_MIN:.0f} % are needed: move the board to the edges and corners "
            "too"
        ): c.coverage >= COVERAGE_MIN,
    }
    return [text for text, good in checks.items() if not good]


def _tilt(rotation: Array) -> float:
    """Return the angle between the board's normal and the camera's axis, deg."""
    return float(np.degrees(np.arccos(np.clip(abs(cv2.Rodrigues(rotation)[0][2, 2]), 0, 1))))


def _coverage(views: Sequence[BoardView], size: tuple[int, int]) -> float:
    uv = np.concatenate([view.uv for view in views])
    counts, _, _ = np.histogram2d(
        uv[:, 0], uv[:, 1], bins=_CELLS, range=((0, size[0]), (0, size[1]))
    )
    return float(np.mean(counts > 0))


def _points(finder: Finder, views: Sequence[BoardView]) -> Points:
    return [(finder.corners(view), view.uv) for view in views]


def _holdout(
    finder: Finder, views: Sequence[BoardView], size: tuple[int, int], options: LensFit
) -> float:
    """Return the rms error, px, of a camera in views that were not fitted.

    Every other view is fitted, and the remaining ones are evaluated, both ways. Only the held-out
    board's pose is fitted. NaN for fewer than three fitted views.
    """
    squares: list[Array] = []
    for first in (0, 1):
        inside = views[first::2]
        outside = views[1 - first :: 2]
        if len(inside) < 3:
            return float("nan")
        fit = fit_intrinsics(_points(finder, inside), size, options)
        for view in outside:
            corners = finder.corners(view)
            projected = fit.project(corners, *fit.pose_of(corners, view.uv))
            squares.append(np.sum((projected - view.uv) ** 2, axis=1))
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def camera_info(c: CameraCalibration, name: str) -> dict[str, Any]:
    """Return the fields of a ROS camera_info file; see `mjtactile.core.camera_file`."""
    return camera_file.camera_info(c.size, c.K, c.lens, name)


def lens_part(c: CameraCalibration, stamp: CalibrationMetadata) -> LensCalibration:
    """Return the lens part of a finger's calibration."""
    return LensCalibration(
        *c.size,
        float(c.K[0, 0]),
        float(c.K[1, 1]),
        float(c.K[0, 2]),
        float(c.K[1, 2]),
        c.lens.coefficients,
        distortion_model=c.lens.model,
        stamp=stamp,
    )


def report(c: CameraCalibration) -> dict[str, Any]:
    """Return the residuals and the data that they are based on."""
    names = ("fx", "fy", "cx", "cy", *c.lens.definition.coefficients)
    return {
        "views": len(c.view_rms),
        "dropped": list(c.dropped),
        "rms_px": c.rms,
        "holdout_px": c.holdout_px,
        "view_rms_px": c.view_rms,
        "sd": {n: float(s) for n, s in zip(names, c.sd, strict=True)},
        "coverage": c.coverage,
        "tilt_deg": [float(t) for t in c.tilts],
    }
