"""Camera drift since the rest reference, with covariance, from fiducials (Eq. F11).

The drift modes are those of `mjtactile.sensing.force.camera_drift_model`, and the image center.
Each moves the centers and sizes of fiducials like those of markers. The fiducials do not depend on
the tractions. So their rows in the fit of the tractions are equivalent to a better prior of the
camera. Their normal equations are solved first, and the markers are corrected by the mean. The
remaining uncertainty enters the fit as unknowns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core import geometry, optics
from mjtactile.core.design import SensorDesign
from mjtactile.core.fiducials import Fiducials
from mjtactile.core.optics import Camera
from mjtactile.core.types import Array, CameraDrift, FiducialDetections
from mjtactile.sensing.force.camera_drift_model import MODES, ImageTransform, camera_modes, tone_of
from mjtactile.sensing.settings import FiducialSettings, InverseSettings

OBSERVED_MODES = MODES + 2
"""Number of modes: those of a camera without fiducials, and the image center, u and v."""
_TURN = 5
_ZOOM = 6
_SIZE = 7
_LEVELS = 8
_AROUND = 24  # points of a circle's outline
_STEP = 1e-3  # step of differences, as a fraction of a mode's sd
_ROUNDS = 4
_BELONGS = 0.5  # fraction of the outlier limit below which no fiducial counts as an outlier
_AS_DARK = 0.03  # maximum change of such levels: a load changes those of markers by 0.01
_LEVELS_MIN = 0.01  # rms change of the inner over the outer level: noise has 0.005
_LINEAR_PX = 0.3  # image motion, px, above which one linear step is not enough


@dataclass(frozen=True, eq=False)
class CameraDriftEstimate:
    """Camera drift in one image. `mean` (K,) holds the modes in units of their standard deviation.
    `root` (K, K) is the lower factor of their covariance. `darker` is the mean darkening of the
    fiducials. `change` is the drift in physical terms. It is None if no fiducials were detected,
    and the drift is from an earlier image."""

    mean: Array
    root: Array
    darker: float
    change: CameraDrift | None


def observed_modes(
    design: SensorDesign, p_SM: Array, darker: Array, s: InverseSettings, settings: FiducialSettings
) -> Array:
    """Return the apparent marker motion (m, 3, OBSERVED_MODES), m. It is the motion for one
    standard deviation of each mode observed by fiducials. Arguments are those of `camera_modes`."""
    modes = np.zeros((len(p_SM), 3, OBSERVED_MODES))
    modes[:, :, :MODES] = camera_modes(design, p_SM, darker, s)
    depth = p_SM[:, 2] + design.camera.distance - design.apparent_glass_thickness
    modes[:, 2, _ZOOM] = -s.drift_zoom * depth
    modes[:, 0, MODES] = settings.center_sd * depth / design.camera.fx
    modes[:, 1, MODES + 1] = settings.center_sd * depth / design.camera.fy
    return modes


class CameraDriftEstimator:
    """Estimator of the camera drift of one sensor with fiducials. `s` has the sds of the modes."""

    def __init__(
        self,
        design: SensorDesign,
        camera: Camera,
        fiducials: Fiducials,
        s: InverseSettings,
        fiducial_settings: FiducialSettings,
    ):
        self.design = design
        self.camera = camera
        self._s = s
        self._own = fiducial_settings
        # standard deviations (3,) not covered by the covariance of the image stages, px
        size = (
            fiducial_settings.glass_size
            if fiducials.surface == "glass"
            else fiducial_settings.floor
        )
        self._floor = np.array([fiducial_settings.floor, fiducial_settings.floor, size])
        self._p_CF = fiducials.p_SF(design) - design.camera.p_SC
        angle = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)
        ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_AROUND)])
        self._ring = fiducials.radius * ring
        self._unmoved = self._outlines(np.eye(3), np.zeros(3))
        self._modes = self._responses()
        # offset from the principal point, px
        away = self._unmoved[:, :2] - [camera.cx, camera.cy]
        self._far = float(np.hypot(away[:, 0], away[:, 1]).mean())

    def find(self, now: FiducialDetections, rest: FiducialDetections) -> CameraDriftEstimate | None:
        """Estimate the camera drift since the rest reference; None if too few fiducials are
        detected."""
        if np.array_equal(now.ids, rest.ids):  # nearly always, and it costs a tenth
            ids = now.ids
            here: Array | slice = slice(None)
            there: Array | slice = slice(None)
        else:
            ids, here, there = np.intersect1d(
                now.ids, rest.ids, assume_unique=True, return_indices=True
            )
        if len(ids) < self._own.min_visible:
            return None
        moved = np.empty((len(ids), 3))
        np.subtract(now.center_px[here], rest.center_px[there], out=moved[:, :2])
        np.subtract(now.radius_px[here], rest.radius_px[there], out=moved[:, 2])
        darker = _darker(now, rest, here, there)
        rows = self._modes[ids]
        rows[:, 2, _LEVELS] = self._s.drift_levels * darker
        # position and size of a circle are nearly independent
        variance = np.diagonal(now.cov[here] + rest.cov[there], axis1=1, axis2=2)
        weight = 1 / np.sqrt(variance + self._floor**2)
        weighted = weight[:, :, None] * rows
        px = _upper_median(np.hypot(moved[:, 0], moved[:, 1]))
        likely = self._prior_sds(px)
        outlier = self._own.outlier
        mean, covariance, misfit = _solve(weighted, weight * moved, likely, outlier)
        if px > _LINEAR_PX:
            before = np.column_stack([rest.center_px, rest.radius_px])[there]
            moved = self._residual(mean, ids, before + moved, before, rows) + rows @ mean
            mean, covariance, misfit = _solve(weighted, weight * moved, likely, outlier)
        grown = self._size_growth(mean, float(darker.mean()))
        covariance[_SIZE, _SIZE] += (self._own.curve_left * grown) ** 2
        root = np.linalg.cholesky(covariance)
        change = self._change(mean, now, rest, here, there, misfit)
        return CameraDriftEstimate(mean, root, float(darker.mean()), change)

    def _size_growth(self, mean: Array, darker: float) -> float:
        """Return the growth of circles that are `darker`, in standard deviations of the size
        mode."""
        s = self._s
        return float(mean[_SIZE]) + s.drift_levels * float(mean[_LEVELS]) * darker / s.drift_size

    def with_size_error(self, observed: CameraDriftEstimate, darker: Array) -> CameraDriftEstimate:
        """Return the drift with added uncertainty for markers that became `darker` (m,).

        Circles grow along a curve as their level changes. Fiducials show one point of this curve
        and its slope. The deviation of markers from that tangent grows with the difference in
        darkness. Where markers clip and fiducials hardly do, the circles of the markers must
        provide the information.
        """
        farther = float(darker.mean()) - observed.darker
        if abs(farther) < _AS_DARK:
            return observed
        bent = self._own.curve_fraction * math.hypot(1.0, float(observed.mean[_LEVELS]))
        bias = self._s.drift_levels * bent * farther / self._s.drift_size
        covariance = observed.root @ observed.root.T
        covariance[_SIZE, _SIZE] += bias**2
        covariance[_LEVELS, _LEVELS] += bent**2
        return replace(observed, root=np.linalg.cholesky(covariance))

    def image(self, mean: Array, darker: float) -> ImageTransform:
        """Return the part of a camera drift `mean` (K,) that is an image transform, for circles
        that are `darker`."""
        s = self._s
        by_levels = s.drift_levels * float(mean[_LEVELS]) * darker
        return ImageTransform(
            np.array([self.camera.cx, self.camera.cy]),
            self._own.center_sd * mean[MODES:],
            s.displaced_rotation * float(mean[_TURN]),
            s.drift_zoom * float(mean[_ZOOM]),
            s.drift_size * float(mean[_SIZE]) + by_levels,
        )

    def correct_positions(self, p_SM: Array, darker: Array, observed: CameraDriftEstimate) -> Array:
        """Return the markers (m, 3), m, frame S, as observed by the camera of the rest reference.
        The image transform is already compensated. `darker` (m,) is as for `camera_modes`."""
        R, aside = self._motion(observed.mean)
        design = self.design
        away = (p_SM - design.camera.p_SC - aside) @ R
        levels_px = self._s.drift_levels * float(observed.mean[_LEVELS])
        if levels_px == 0.0:
            return design.camera.p_SC + away
        # from the camera's apparent position through the glass, distance is inverse to the radius
        apparent = away - [0.0, 0.0, design.apparent_glass_thickness]
        radius_px = design.camera.fx * design.markers.radius / apparent[:, 2]
        radius_change_px = levels_px * (darker - observed.darker)
        nearer = radius_change_px / (radius_px - radius_change_px)
        return design.camera.p_SC + away + nearer[:, None] * apparent

    def _motion(self, mean: Array) -> tuple[Array, Array]:
        """Return rotation (3, 3) and shift (3,), m, of the scene in the camera, without image
        rotation."""
        s = self._s
        rotation = s.displaced_rotation * np.array([mean[3], mean[4], 0.0])
        return geometry.rotation_from_vector(rotation), s.displaced_shift * mean[:3]

    def _residual(self, mean: Array, ids: Array, shown: Array, before: Array, rows: Array) -> Array:
        """Return the residual of circles (n, 3), px, from `before` to `shown`, after the drift
        `mean`."""
        image = self.image(mean, 0.0)
        then = before + (self._outlines(*self._motion(mean)) - self._unmoved)[ids]
        levels = rows[:, 2, _LEVELS] * mean[_LEVELS]
        radius = (shown[:, 2] - levels - image.grown) / (1 + image.scale)
        return np.column_stack([image.inverse(shown[:, :2]), radius]) - then

    def _prior_sds(self, moved_px: float) -> Array:
        """Return the prior standard deviations (K,) of the modes for the observed image motion.
        They scale with this motion. Planar circles do not separate all modes. Modes that cancel are
        as unlikely as a displacement without image motion."""
        s = self._s
        camera = self.design.camera
        px = max(moved_px, self._own.still)
        sd = np.ones(OBSERVED_MODES)
        sd[:3] = px * camera.distance / camera.fx / s.displaced_shift
        sd[2] *= self._own.axial
        sd[3:6] = px / camera.fx / s.displaced_rotation
        sd[_ZOOM] = px / self._far / s.drift_zoom
        sd[MODES:] = px / self._own.center_sd
        return sd

    def _responses(self) -> Array:
        """Compute the change of (u, v, radius) of each fiducial, px, per standard deviation of each
        mode. Shape (F, 3, K). Camera shifts and rotations use finite differences of the projected
        outline."""
        s = self._s
        size = s.drift_size
        found = np.zeros((len(self._p_CF), 3, OBSERVED_MODES))
        nothing = self._unmoved
        for k, axis in enumerate(np.eye(3)):
            aside = self._outlines(np.eye(3), _STEP * s.displaced_shift * axis)
            turned = self._outlines(
                geometry.rotation_from_vector(_STEP * s.displaced_rotation * axis), np.zeros(3)
            )
            found[:, :, k] = (aside - nothing) / _STEP
            found[:, :, 3 + k] = (turned - nothing) / _STEP
        center = [self.camera.cx, self.camera.cy, 0.0]
        found[:, :, _ZOOM] = s.drift_zoom * (nothing - center)
        found[:, 2, _SIZE] = size
        found[:, 0, MODES] = found[:, 1, MODES + 1] = self._own.center_sd
        return found

    def _outlines(self, R: Array, aside: Array) -> Array:
        """Return center u, v and radius (F, 3), px, of the moved fiducials. They are rotated by `R`
        about the camera and shifted by `aside` (3,), m."""
        outline = (self._p_CF[:, None] + self._ring) @ R.T + aside
        uv = optics.project(self.camera, outline)
        ahead = np.roll(uv, -1, axis=1)
        cross = uv[..., 0] * ahead[..., 1] - ahead[..., 0] * uv[..., 1]
        area = np.abs(cross.sum(axis=1)) / 2
        return np.column_stack([uv.mean(axis=1), np.sqrt(area / np.pi)])

    def _change(
        self,
        mean: Array,
        now: FiducialDetections,
        rest: FiducialDetections,
        here: Array | slice,
        there: Array | slice,
        misfit: float,
    ) -> CameraDrift:
        s = self._s
        design = self.design
        camera = design.camera
        # shift of the image center, at the membrane's distance
        offset = s.displaced_shift * mean[:2] / camera.distance
        rotation = s.displaced_rotation * mean[3:6]
        shift = (offset + [rotation[1], -rotation[0]]) * [camera.fx, camera.fy]
        shift += self._own.center_sd * mean[MODES:]
        nearer = -s.displaced_shift * float(mean[2]) / camera.distance
        tone = tone_of(now.inside[here], now.outside[here], rest.inside[there], rest.outside[there])
        blur = np.square(now.blur_px[here]) - np.square(rest.blur_px[there])
        more = _upper_median(blur)
        return CameraDrift(
            shift=(float(shift[0]), float(shift[1])),
            turn=float(rotation[2]),
            scale=s.drift_zoom * float(mean[_ZOOM]) + nearer,
            radius_change_px=s.drift_size * float(mean[_SIZE]),
            light=tone.light,
            gamma=tone.gamma,
            black=tone.black,
            blur_px=float(np.copysign(np.sqrt(abs(more)), more)),
            seen=len(blur),
            misfit=misfit,
        )


def _solve(rows: Array, moved: Array, likely: Array, outlier: float) -> tuple[Array, Array, float]:
    """Return mean, covariance and misfit of the modes, fitted robustly. `rows` (n, 3, K) are the
    weighted rows, `likely` (K,) the prior standard deviations, and `moved` (n, 3) the data. A
    fiducial `outlier` times farther off than the others gets a small weight."""
    n, _, K = rows.shape
    flat = rows.reshape(-1, K)
    moves = moved.ravel()
    weight = np.ones(n)
    covariance = np.diag(likely**2)
    for _ in range(_ROUNDS):
        weighted = flat * np.repeat(weight, 3)[:, None]
        normal = weighted.T @ flat
        normal.ravel()[:: K + 1] += likely**-2
        covariance = np.linalg.inv(normal)
        mean = covariance @ (moves @ weighted)
        left = moves - flat @ mean
        square = np.square(left).reshape(n, 3).sum(axis=1) / 3
        usual = max(_upper_median(square), 1.0)
        if square.max() < _BELONGS * outlier * usual and weight.min() > _BELONGS:
            break
        weight = 1 / (1 + np.square(square / (outlier * usual)))
    misfit = float(weight @ square / weight.sum())
    covariance *= max(misfit, 1.0)
    return mean, covariance, misfit


def _darker(
    now: FiducialDetections, rest: FiducialDetections, here: Array | slice, there: Array | slice
) -> Array:
    """Return the change (n,) of the log ratio of inside to outside level. It is set to zero if it
    is only noise of the levels. Such noise would give a false slope of the curve."""
    then = rest.inside[there] / rest.outside[there]
    darker = np.log(now.inside[here] / now.outside[here] / then)
    # False for NaN: unknown
    known = np.abs(darker) < np.inf
    if not known.all():
        darker[~known] = 0.0
    changed = float(darker @ darker) > len(darker) * _LEVELS_MIN**2
    return darker if changed else np.zeros_like(darker)


def _upper_median(values: Array) -> float:
    """Return the median; of an even count the upper of the two central values."""
    return float(np.sort(values)[len(values) // 2])
