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
from mjtactile.optics import Camera, glass_shift
from mjtactile.sensing import identity
from mjtactile.sensing.contact import find_contact, resample
from mjtactile.sensing.deformation import Fields, MembraneModel
from mjtactile.sensing.force import AreaCalibration, GridForce, MembraneForce, RestState, spring_grid_force
from mjtactile.sensing.markers import detect
from mjtactile.sensing.pose import estimate_poses
from mjtactile.sensing.surface import SurfaceFitter
from mjtactile.types import Array, CirclePoses, Contact, Image, Markers, Surface, Touch, Traction

FEWEST_SEEN = 0.4  # share of the markers below which the shape is a guess
RADIUS_RANGE = 0.1  # a marker whose size is off by more than this share is not the one in the sensor file
TOUCH_SD = 4.0  # a touch is a force above four standard deviations: one false alarm in 10^4 images
TOUCH_LEAST = 0.04  # N, and above what the model itself is sure of near zero


@dataclass(frozen=True, eq=False)
class Reference:
    """What the chain knows of its own sensor at rest: marker `scale` (N,) of depth (true radius over nominal), the
    statics at rest, the rest `surface` and grid forces."""

    scale: Array
    rest: RestState
    surface: Surface
    grid_force: Array


class SensorPipeline:
    """The sensing chain of one sensor. Keeps the reference and, for marker identity, the last marker positions.

    The force comes from statics; with an `area_calibration` it comes the paper's way instead: the net force from the
    change of area, its distribution from a grid of springs.
    """

    def __init__(self, design: SensorDesign, *, area_calibration: AreaCalibration | None = None):
        self.design, self.area_calibration = design, area_calibration
        self.camera = Camera.from_design(design.camera, design.glass)
        self.model = MembraneModel(design)
        self.statics = MembraneForce(self.model)
        self.fitter = SurfaceFitter(design)
        self.grid = GridForce(self.statics)
        self.reference: Reference | None = None
        self._scale = np.ones(design.markers.count)
        self._last = design.markers.p_SM

    # -- the sensor's own reference --------------------------------------------------------------------------------

    def take_flat(self, images: Sequence[Image]) -> None:
        """Measure each marker's radius on the flat membrane (valve open), whose plane the sensor file gives.

        Depth goes with the assumed radius, so the ratio of known to measured depth corrects it for each marker.
        Raises DeviceError when markers are missing or too far from where the sensor file has them.
        """
        self._scale = np.ones(self.design.markers.count)
        depths = [[] for _ in range(self.design.markers.count)]
        for image in images:
            markers = self._locate(image, self.design.markers.p_SM, "flat reference")
            for i, z in zip(markers.ids, self._apparent_depth(markers.p_SM), strict=True):
                depths[i].append(z)
        wanted = self._apparent_depth(self.design.markers.p_SM)
        self._scale = np.array([w / np.mean(d) if d else 1.0 for w, d in zip(wanted, depths, strict=True)])
        worst = int(np.argmax(np.abs(self._scale - 1)))
        if abs(self._scale[worst] - 1) > RADIUS_RANGE:
            raise DeviceError(f"sensor {self.design.name}: flat reference: marker {worst} looks "
                              f"{100 * (self._scale[worst] - 1):+.0f} % off in size or distance; check [markers] radius_mm "
                              "and [camera] distance_mm, and that the valve is open")

    def take_rest(self, images: Sequence[Image], pressure_gauge: float, *, sealed: bool = True) -> None:
        """Measure the inflated membrane with nothing touching, at a known gauge pressure, Pa.

        `sealed`: from here on the chamber keeps its gas; otherwise the valve keeps its pressure.
        """
        self._last = self.design.markers.p_SM
        seen = [self._locate(image, self._last, "rest reference") for image in images]
        markers = _average(seen)
        rest = self.statics.rest_state(markers, pressure_gauge, sealed=sealed)
        fields = self._fields(markers)
        self.reference = Reference(self._scale, rest, self.fitter.fit(markers),
                                   self.grid.forces(fields, pressure_gauge, rest))
        self._last = self.model.displacement(self.model.fit(markers.ids, markers.p_SM), self.model.material)
        self._last = self._last + self.design.markers.p_SM

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
        traction = self._traction(markers) if self.area_calibration is None else self._paper_traction(surface)
        force, sd = -float(traction.wrench[2]), float(np.sqrt(traction.wrench_cov[2, 2]))
        touching = force > max(TOUCH_LEAST, TOUCH_SD * sd)
        contact = self._contact(surface, traction, touching)
        return Touch(image.time, now - image.time, force, sd, touching, contact, traction, surface, markers)

    def markers(self, image: Image) -> Markers:
        """Identified markers in S."""
        poses = estimate_poses(detect(image, self.camera), self.camera, self.design.markers.radius)
        markers = self._identify(poses)
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

    def _identify(self, poses: CirclePoses) -> Markers:
        return identity.identify(poses, self.design, self._last, self._scale)

    def _apparent_depth(self, p_SM: Array) -> Array:
        """Depth below which size is seen: from the camera's centre, less the pane's shift."""
        p_CM = p_SM - self.design.camera.p_SC
        return p_CM[:, 2] - glass_shift(self.camera, p_CM)

    def _fields(self, markers: Markers) -> Fields:
        return self.model.fields(self.model.fit(markers.ids, markers.p_SM))

    def _traction(self, markers: Markers) -> Traction:
        reference = self.reference
        assert reference is not None
        fields = self._fields(markers)
        wrench, gauge = self.statics.wrench_of(fields, reference.rest)
        cov = self.statics.wrench_cov(markers, reference.rest)
        nodal = self.grid.forces(fields, gauge, reference.rest) - reference.grid_force
        return Traction(self.grid.x, self.grid.y, nodal, wrench, cov, gauge, method="statics")

    def _paper_traction(self, surface: Surface) -> Traction:
        """The paper's levels 1 and 2: dF = c dA for the sum, a grid of springs for how it is spread."""
        assert self.reference is not None and self.area_calibration is not None
        rest, (x, y) = self.reference.surface, (self.grid.x, self.grid.y)
        now, before = (replace(s, x=x, y=y, z=resample(s, x, y)) for s in (surface, rest))
        nodal = spring_grid_force(now, before, self.design.membrane.pretension)
        wrench, cov = np.zeros(6), np.zeros((6, 6))
        wrench[2] = -self.area_calibration.force(surface.area - rest.area)
        cov[2, 2] = self.area_calibration.residual**2 + (self.area_calibration.constant * surface.area_sd) ** 2
        return Traction(x, y, nodal, wrench, cov, np.nan, method="paper")

    def _contact(self, surface: Surface, traction: Traction, touching: bool) -> Contact:
        assert self.reference is not None
        return find_contact(surface, self.reference.surface, traction, touching=touching)


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
