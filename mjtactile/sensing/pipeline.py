"""One sensor's chain from an image to touch; the only place where the stages meet. Works from pixels alone.

`SensorPipeline` first measures its own reference, as the real device must: the flat membrane with the valve open,
then the inflated one with nothing touching. After that `perceive` turns each image into a `Touch`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.design import SensorDesign
from mjtactile.errors import DeviceError
from mjtactile.optics import Camera
from mjtactile.sensing import identity, slip, zero
from mjtactile.sensing.contact import find_contact, resample
from mjtactile.sensing.force import AreaCalibration, spring_grid_force
from mjtactile.sensing.inverse import InverseMembrane, InverseRest, Shape
from mjtactile.sensing.markers import detect
from mjtactile.sensing.patches import find_patches, together
from mjtactile.sensing.pose import estimate_poses
from mjtactile.sensing.reference import FlatReference, measure_flat
from mjtactile.sensing.surface import SurfaceFitter
from mjtactile.types import Array, Image, Markers, Surface, Touch, Traction

FEWEST_SEEN = 0.4  # share of the markers below which the shape is a guess
TOUCH_SD, TOUCH_LEAST = 4.0, 0.04  # with the paper's force: its residual's sd, and N
STIFFNESS_OFF_MAX = 3.0  # of the sensor file's stiffness; cast rubber varies by a factor of 1.5 from batch to batch
MISFIT_MAX = 50.0  # mean square of the markers' misfit over their sd above which the shape is not explained


@dataclass(frozen=True, eq=False)
class Reference:
    """What the chain knows of its own sensor at rest: its statics and its `surface`."""

    rest: InverseRest
    surface: Surface


class SensorPipeline:
    """The sensing chain of one sensor. Keeps the reference and what the last image showed: marker positions (for their
    identity), the membrane's shape (to start from), the histories of touch and slip.

    The force comes from inverse finite elements; with an `area_calibration` it comes the paper's way instead: the net
    force from the change of area, its distribution from a grid of springs.
    """

    def __init__(self, design: SensorDesign, *, area_calibration: AreaCalibration | None = None):
        self.design, self.area_calibration = design, area_calibration
        self.camera = Camera.from_design(design.camera, design.glass)
        self.inverse = InverseMembrane(design)
        self.fitter = SurfaceFitter(design)
        self.flat = FlatReference.nominal(design)
        self.reference: Reference | None = None
        self._last = design.markers.p_SM
        # seen 60 degrees aslant and from half as far again
        self._smallest_px = max(1.5, 0.33 * self.camera.fx * design.markers.radius / design.camera.distance)
        self._forget()

    def _forget(self) -> None:
        """Start the histories anew."""
        self._shape: Shape | None = None
        self._watch: zero.Watch | None = None
        self._slip: slip.SlipHistory | None = None

    # -- the sensor's own reference --------------------------------------------------------------------------------

    def take_flat(self, images: Sequence[Image]) -> FlatReference:
        """Measure the camera's pose and each marker's radius on the flat membrane (valve open to the air).

        Raises DeviceError when too few markers are seen, or they do not agree with the sensor file.
        """
        self.flat = FlatReference.nominal(self.design)
        seen = [self._locate(image, self.design.markers.p_SM, "flat reference") for image in images]
        self.flat = measure_flat(self.design, self.camera, seen)
        return self.flat

    def take_rest(self, images: Sequence[Image], pressure_gauge: float, *, sealed: bool = True) -> Markers:
        """Measure the inflated membrane with nothing touching, at a known gauge pressure, Pa.

        `sealed`: from here on the chamber keeps its gas; otherwise the valve keeps its pressure. Raises DeviceError when the
        membrane does not bulge as it must: a valve that did not move where no pressure sensor says so, or another membrane.
        """
        self._last = self.design.markers.p_SM
        markers = _average([self._locate(image, self._last, "rest reference") for image in images])
        self.set_rest(markers, pressure_gauge, sealed=sealed)
        return markers

    def set_rest(self, markers: Markers, pressure_gauge: float, *, sealed: bool = True) -> None:
        """Use a rest state that was measured before; see `take_rest`."""
        rest = self.inverse.rest_state(markers, pressure_gauge, sealed=sealed)
        if not 1 / STIFFNESS_OFF_MAX < rest.stiffness_scale < STIFFNESS_OFF_MAX:
            bulge = 1e3 * float(np.abs(markers.p_SM[:, 2]).max())
            raise DeviceError(f"sensor {self.design.name}: at {pressure_gauge:.0f} Pa the markers stand {bulge:.2f} mm high at "
                              f"most, as if the membrane were {rest.stiffness_scale:.1f} times as stiff as in the sensor file: "
                              "does the valve move, and are the membrane's young_MPa and thickness_mm right?")
        self.reference = Reference(rest, self.fitter.fit(markers))
        self._last = self.inverse.positions(rest.c)
        self._forget()

    # -- an image ----------------------------------------------------------------------------------------------------

    def perceive(self, image: Image, now: float) -> Touch:
        """Touch from one image; `now` s on the clock of the image's time. Needs both references first."""
        if self.reference is None:
            raise DeviceError(f"sensor {self.design.name}: perceive() before take_flat() and take_rest()")
        unknown = Touch(image.time, now - image.time, np.nan, np.nan, False)
        markers = self.markers(image)
        if len(markers) < FEWEST_SEEN * self.design.markers.count:
            return replace(unknown, status=f"only {len(markers)} of {self.design.markers.count} markers seen")
        surface = self.fitter.fit(markers)
        if self.area_calibration is not None:
            return self._paper_touch(unknown, markers, surface)
        return replace(self.touch_of(markers, surface, image.time), age=unknown.age)

    def touch_of(self, markers: Markers, surface: Surface, time: float) -> Touch:
        """Force, contact and slip by inverse finite elements, from markers and surface at `time` s."""
        if self.reference is None:
            raise DeviceError(f"sensor {self.design.name}: touch_of() before take_rest()")
        unknown = Touch(time, 0.0, np.nan, np.nan, False)
        rest, before = self.reference.rest, self._watch
        self._shape = shape = self.inverse.estimate(markers, rest, self._shape)
        if not shape.misfit < MISFIT_MAX:
            self._forget()
            lost = slip.unknown("shape not explained")
            return replace(unknown, surface=surface, markers=markers, slip=lost, status="the markers fit no membrane shape")
        traction = self.inverse.traction(shape)
        self._watch = watch = zero.watch(unknown.time, traction, before)
        patches = find_patches(self.inverse, shape, rest) if watch.touching else ()
        judged, self._slip = slip.judge(unknown.time, self.inverse, shape, patches, self._slip)
        quiet = before is not None and not watch.touching and watch.time - watch.quiet_since > zero.QUIET
        if quiet and before is not None:
            rest = zero.follow(self.inverse, rest, shape, markers, watch.time - before.time)
            self.reference = replace(self.reference, rest=rest)
        sd = float(np.sqrt(traction.wrench_cov[2, 2]))
        if quiet and (watch.force < -max(zero.PULL_MOST, zero.TOUCH_SD * sd) or shape.drift > zero.DRIFT_MOST):
            return replace(unknown, traction=traction, surface=surface, markers=markers, slip=slip.unknown("no zero"),
                           status="the membrane seems pulled, or shifted: the rest reference is lost (temperature, camera)")
        return replace(unknown, force_normal=watch.force, force_normal_sd=sd, touching=watch.touching, surface=surface,
                       contact=together(patches, (len(traction.y), len(traction.x))), traction=traction, markers=markers,
                       patches=patches, slip=judged)

    def _paper_touch(self, unknown: Touch, markers: Markers, surface: Surface) -> Touch:
        """Force by the paper's levels 1 and 2."""
        assert self.reference is not None
        traction = self._paper_traction(surface)
        force, sd = -float(traction.wrench[2]), float(np.sqrt(traction.wrench_cov[2, 2]))
        touching = force > max(TOUCH_LEAST, TOUCH_SD * sd)
        contact = find_contact(surface, self.reference.surface, traction, touching=touching)
        return replace(unknown, force_normal=force, force_normal_sd=sd, touching=touching, contact=contact,
                       traction=traction, surface=surface, markers=markers, slip=slip.unknown("needs membrane statics"))

    def markers(self, image: Image) -> Markers:
        """Identified markers in S."""
        ellipses = detect(image, self.camera, min_radius_px=self._smallest_px)
        poses = estimate_poses(ellipses, self.camera, self.design.markers.radius)
        poses = self.flat.to_nominal(self.design, poses)
        markers = identity.identify(poses, self.design, self._last, self.flat.scale)
        self._last = self._last.copy()
        self._last[markers.ids] = markers.p_SM
        return markers

    def _locate(self, image: Image, expected: Array, what: str) -> Markers:
        self._last = expected
        markers = self.markers(image)
        if len(markers) < FEWEST_SEEN * self.design.markers.count:
            raise DeviceError(f"sensor {self.design.name}: {what}: only {len(markers)} of {self.design.markers.count} "
                              "markers found; check lighting, focus and the sensor file")
        return markers

    def _paper_traction(self, surface: Surface) -> Traction:
        """The paper's levels 1 and 2: dF = c dA for the sum, a grid of springs for how it is spread."""
        assert self.reference is not None and self.area_calibration is not None
        rest, x, y = self.reference.surface, self.inverse.x, self.inverse.y
        now, before = (replace(s, x=x, y=y, z=resample(s, x, y)) for s in (surface, rest))
        nodal = spring_grid_force(now, before, self.design.membrane.pretension)
        wrench, cov = np.zeros(6), np.zeros((6, 6))
        wrench[2] = -self.area_calibration.force(surface.area - rest.area)
        cov[2, 2] = self.area_calibration.residual**2 + (self.area_calibration.constant * surface.area_sd) ** 2
        return Traction(x, y, nodal, wrench, cov, np.nan, method="paper")


def _average(seen: Sequence[Markers]) -> Markers:
    """Mean of repeated measurements of markers at rest; a marker counts when at least half of them saw it."""
    count = np.bincount(np.concatenate([m.ids for m in seen]))
    total, normal = np.zeros((len(count), 3)), np.zeros((len(count), 3))
    cov = np.zeros((len(count), 3, 3))
    for m in seen:
        total[m.ids] += m.p_SM
        normal[m.ids] += m.n_S
        cov[m.ids] += m.cov_p
    ids = np.flatnonzero(count >= len(seen) / 2)
    n = count[ids][:, None]
    direction = normal[ids] / np.linalg.norm(normal[ids], axis=1, keepdims=True)
    return Markers(ids, total[ids] / n, direction, cov[ids] / n[..., None] ** 2)
