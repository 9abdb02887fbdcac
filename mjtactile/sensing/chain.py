"""One sensor's chain from an image to touch; the only place where the stages meet. Works from
pixels alone.

A `Chain` is what stays the same: the sensor and the operators made from its design. A `ChainState`
is what one image leaves for the next. `step(state, image, now)` gives the touch and the next state
and changes nothing, so that a state can be kept, replayed, handed to another process, or tried
twice.

A sensor first measures its own reference, as the real device must: the flat membrane with the valve
open, then the inflated one with nothing touching. `Perception` keeps a chain and its newest state
together for those that only go forward.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mjtactile.core.calibration import Calibration
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import DeviceError
from mjtactile.core.optics import Camera
from mjtactile.core.status import OK, Status, StatusCode
from mjtactile.core.types import (
    Array,
    Contact,
    Ellipses,
    FeltShape,
    Image,
    Markers,
    PressureReading,
    Sighting,
    Surface,
    Touch,
    Traction,
)
from mjtactile.sensing.body.finder import ShapeFinder
from mjtactile.sensing.body.motion import rubber_step
from mjtactile.sensing.estimate import Estimate, ShapeEstimator
from mjtactile.sensing.force import bulge, zero
from mjtactile.sensing.force.inverse import InverseMembrane, InverseRest
from mjtactile.sensing.force.relaxing import RubberMemory
from mjtactile.sensing.image import tracking
from mjtactile.sensing.image.exposure import is_overexposed
from mjtactile.sensing.image.markers import grey_image
from mjtactile.sensing.known import KnownCamera
from mjtactile.sensing.pose import fixed, identity
from mjtactile.sensing.pose.circles import estimate_poses
from mjtactile.sensing.pose.reference import FlatReference, measure_flat
from mjtactile.sensing.settings import DEFAULTS, Settings
from mjtactile.sensing.shape.surface import SurfaceFitter
from mjtactile.sensing.shaped import finder_gauge, with_shape
from mjtactile.sensing.state import ChainState, Reference
from mjtactile.sensing.touch import slip
from mjtactile.sensing.touch.patches import find_patches, together

_OVERLOADS_SURE = 2  # images in a row: a torn picture is no overload


class Chain:
    """The sensing chain of one sensor: operators made from its design once; nothing changes.

    What was measured of it stands in for what the sensor file says, but for parts that are
    outdated. The force comes from inverse finite elements.

    Args:
        design: The sensor file's values.
        calibration: What was measured of this sensor; None: nothing.
        settings: The stages' chosen numbers.
    """

    def __init__(
        self,
        design: SensorDesign,
        calibration: Calibration | None = None,
        *,
        settings: Settings = DEFAULTS,
    ):
        design.require_markers_that_fit()
        if calibration is None:
            self._measured = Calibration("", design.name)
        else:
            self._measured = calibration.used(design)
        self.design = design = self._measured.design(design)
        self.settings = settings
        self.camera = Camera.from_design(design.camera, design.glass)
        self.inverse = InverseMembrane(
            design, settings.inverse, settings.prior, settings.doubt, settings.fiducials
        )
        self.known = (
            None if design.fiducials is None else KnownCamera(design, self.camera, settings)
        )
        self._circles = design.markers.count + (0 if self.known is None else self.known.count)
        self.estimator = ShapeEstimator(design, self.inverse, settings)
        self.fitter = SurfaceFitter(design, settings.surface)
        # seen 60 degrees aslant and from half as far again
        self._smallest_px = max(
            1.5, 0.33 * self.camera.fx * design.markers.radius / design.camera.distance
        )

    def begin(self) -> ChainState:
        """Make the state before anything was measured: what the sensor file says.

        Returns:
            A state without references.
        """
        return ChainState(FlatReference.nominal(self.design), self.design.markers.p_SM)

    def recall(self) -> ChainState:
        """Make the state with the references that `calibrate frame` measured, if there are any.

        Returns:
            The state.
        """
        state = self.begin()
        frame = self._measured.frame
        if frame is None:
            return state
        flat = FlatReference(frame.R_SC, frame.p_SC, frame.scale, frame.residual_px, frame.scale_sd)
        state = replace(state, flat=flat)
        rest = frame.rest
        if rest is None:
            return state
        return self.set_rest(state, rest.markers, rest.pressure_gauge, sealed=rest.sealed)

    # -- the sensor's own reference
    # --------------------------------------------------------------------------------

    def take_flat(self, state: ChainState, images: Sequence[Image]) -> ChainState:
        """Measure the camera's pose and each marker's radius on the flat membrane.

        Args:
            state: Any state; its own references are replaced.
            images: With the valve open to the air, nothing touching.

        Returns:
            The state with the flat reference.

        Raises:
            DeviceError: Too few markers are seen, or they do not agree with the sensor file.
        """
        nominal = replace(state, flat=FlatReference.nominal(self.design))
        seen = [
            self._locate(nominal, image, self.design.markers.p_SM, "flat reference")
            for image in images
        ]
        flat = measure_flat(self.design, self.camera, seen, self.settings.reference)
        flat_at = max((image.time for image in images), default=-math.inf)
        return replace(nominal, flat=flat, expected=self.design.markers.p_SM, flat_at=flat_at)

    def take_rest(
        self,
        state: ChainState,
        images: Sequence[Image],
        pressure_gauge: float,
        *,
        sealed: bool = True,
    ) -> ChainState:
        """Measure the inflated membrane with nothing touching.

        Args:
            state: With the flat reference.
            images: Of the membrane at rest.
            pressure_gauge: Pa in the chamber, above ambient.
            sealed: Whether the chamber keeps its gas from here on; otherwise the valve keeps its
                pressure.

        Returns:
            The state with the rest reference, without history.

        Raises:
            DeviceError: The membrane does not bulge as it must: a valve that did not move where no
                pressure sensor says so, or another membrane.
        """
        markers = self.rest_markers(state, images)
        time = max(image.time for image in images)
        return self.set_rest(state, markers, pressure_gauge, sealed=sealed, time=time)

    def rest_markers(self, state: ChainState, images: Sequence[Image]) -> Markers:
        """Find the markers of an inflated membrane that nothing touches.

        Args:
            state: With the flat reference.
            images: Of the membrane at rest.

        Returns:
            The markers, the mean of the images.

        Raises:
            DeviceError: Too few are seen.
        """
        expected = self.design.markers.p_SM
        seen = []
        for image in images:
            markers = self._locate(state, image, expected, "rest reference")
            expected = _moved(expected, markers)
            seen.append(markers)
        if not seen:
            raise DeviceError(f"sensor {self.design.name}: rest reference: no images")
        return _average(seen)

    def set_rest(
        self,
        state: ChainState,
        markers: Markers,
        pressure_gauge: float,
        *,
        sealed: bool = True,
        time: float = math.inf,
    ) -> ChainState:
        """Use a rest state that was measured before; see `take_rest`.

        Args:
            state: With the flat reference.
            markers: At rest.
            pressure_gauge: Pa in the chamber then.
            sealed: Whether the chamber keeps its gas.
            time: When it was measured, s on the images' clock; left out: so long ago that rubber
                that relaxes has done so.

        Returns:
            The state with the rest reference, without history.

        Raises:
            DeviceError: The markers are no bulge of the sensor file's.
        """
        self._require(markers, "rest reference")
        inflated_s = math.inf if math.isinf(time) else time - state.flat_at
        rest = self.inverse.rest_state(
            markers, pressure_gauge, sealed=sealed, inflated_s=inflated_s
        )
        self._check_rest(state, markers, rest, pressure_gauge)
        return replace(
            state,
            reference=Reference(rest, self.fitter.fit(markers), rest, markers.fiducials),
            expected=self.inverse.positions(rest.c),
            gas=None,
            knocked=0,
            camera=None,
            belief=None,
            rubber=self._remembered(rest, inflated_s, time),
        ).without_history()

    def _remembered(self, rest: InverseRest, inflated_s: float, time: float) -> RubberMemory | None:
        """What the rubber remembers at the rest reference; None: it does not relax."""
        if self.inverse.rubber is None:
            return None
        return self.inverse.rubber.begin(rest.c, rest.young, inflated_s, time)

    def _check_rest(
        self, state: ChainState, markers: Markers, rest: InverseRest, pressure_gauge: float
    ) -> None:
        """Raise DeviceError where the membrane is no bulge of the sensor file's, in height or in
        shape."""
        most = self.settings.reference.stiffness_off_most
        if not 1 / most < rest.stiffness_scale < most:
            height = 1e3 * float(np.abs(markers.p_SM[:, 2]).max())
            raise DeviceError(
                f"sensor {self.design.name}: at {pressure_gauge:.0f} Pa the markers stand "
                f"{height:.2f} mm high at most, as if the membrane were "
                f"{rest.stiffness_scale:.1f} times as stiff as in the sensor file: does the valve "
                "move, and are the membrane's young_MPa and thickness_mm right?"
            )
        # hardly a bulge, and no stiffness was fitted to it
        if pressure_gauge <= self.settings.inverse.informative_pressure:
            return
        z = self.inverse.positions(rest.c)[markers.ids, 2]
        misfit = bulge.misfit(
            self.design,
            markers,
            z,
            state.flat.residual_px,
            lens_measured=self._measured.lens is not None,
            s=self.settings.reference,
        )
        if misfit > self.settings.reference.bulge_misfit_most:
            off = 1e3 * float(np.abs(markers.p_SM[:, 2] - z).max())
            raise DeviceError(
                f"sensor {self.design.name}: at rest the membrane is not the bulge that "
                f"{pressure_gauge:.0f} Pa make: markers are up to {off:.2f} mm off "
                f"({np.sqrt(misfit):.1f} standard deviations, rms); does something touch it? Else "
                "the lens is not as in the sensor file: `mjtactile calibrate camera`"
            )

    # -- what touches
    # --------------------------------------------------------------------------------

    def shape_finder(self, state: ChainState) -> ShapeFinder:
        """Make what finds shapes with this rest; a tenth of a second, once for a rest.

        Args:
            state: With the rest reference.

        Returns:
            The finder: of the rest as it was first measured, and of about the gas that is there
            now.

        Raises:
            DeviceError: The rest reference is missing.
        """
        reference = self._require_reference(state, "a shape")
        return ShapeFinder(self.design, reference.first, finder_gauge(reference), self.settings)

    def find_shape(
        self, state: ChainState, touches: Sequence[Touch], finder: ShapeFinder
    ) -> FeltShape:
        """Say what body touches in the newest of some touches.

        Args:
            state: With the rest reference.
            touches: Of one press, oldest first.
            finder: Of this rest.

        Returns:
            The shape; "unknown", with a status, where it cannot be said.

        Raises:
            DeviceError: The rest reference is missing.
        """
        return finder.find(touches, self._rest_markers(state))

    def follow_shape(
        self, before: ChainState, after: ChainState, touch: Touch, finder: ShapeFinder
    ) -> tuple[Touch, ChainState]:
        """Find what body touches, from what the images before have told of it.

        Args:
            before: The state before the image.
            after: The state after it.
            touch: What it was felt to be.
            finder: Of this rest.

        Returns:
            The touch with its shape, area and force by it, and the state that remembers the press.

        Raises:
            DeviceError: The rest reference is missing.
        """
        rubber = None
        if before.slip is not None and after.slip is not None:
            rubber = rubber_step(
                (before.slip.weight, after.slip.weight), (before.slip.position, after.slip.position)
            )
        found = finder.follow(touch, before.press, self._rest_markers(after), rubber)
        felt = with_shape(touch, found.shape, found.load)
        return felt, replace(after, press=found.press)

    def _require_reference(self, state: ChainState, what: str) -> Reference:
        if state.reference is None:
            raise DeviceError(f"sensor {self.design.name}: {what} before the rest reference")
        return state.reference

    def _rest_markers(self, state: ChainState) -> Array:
        """Where they stand at rest, (N, 3) m in S."""
        rest = self._require_reference(state, "a shape").rest
        return self.inverse.positions(rest.c) + rest.offset

    # -- an image
    # --------------------------------------------------------------------------------

    def step(
        self, state: ChainState, image: Image, now: float, reading: PressureReading | None = None
    ) -> tuple[Touch, ChainState]:
        """Feel what one image shows. Changes nothing: the same state and image give the same touch.

        Args:
            state: What the image before left, with both references.
            image: The image.
            now: s on the clock of the image's time.
            reading: Newest reading of the chamber's pressure gauge; None: there is none.

        Returns:
            The touch, in whose status is what is wrong with the image, and the state for the next.

        Raises:
            DeviceError: The references are missing.
        """
        if state.reference is None:
            raise DeviceError(
                f"sensor {self.design.name}: an image before the references of the flat and the "
                "resting membrane"
            )
        unknown = Touch(image.time, now - image.time, np.nan, np.nan, False)
        markers, state = self.see(state, image)
        if (status := self.enough(markers)) != OK:
            return replace(unknown, status=status), state
        if state.camera is not None:
            unknown = replace(unknown, camera=state.camera.change)
        surface = self.fitter.fit(markers)
        touch, state = self.feel(state, markers, surface, image.time, reading)
        return replace(touch, age=unknown.age, camera=unknown.camera), state

    def see(self, state: ChainState, image: Image) -> tuple[Markers, ChainState]:
        """Find and identify the markers in one image.

        Args:
            state: What the image before left.
            image: The image.

        Returns:
            The markers in S, and the state in which they are expected where they are now.
        """
        ellipses, tracks = self._ellipses(state, image)
        if self.known is not None:
            ellipses, state = self.known.look(state, ellipses)
        poses = estimate_poses(ellipses, self.camera, self.design.markers.radius)
        poses = state.flat.to_nominal(self.design, poses)
        markers = identity.identify(
            poses,
            self.design,
            state.expected,
            state.flat.scale,
            self.settings.identity,
            darkness=ellipses.darkness,
        )
        if self.known is not None:
            markers = self.known.undone(state, markers)
        return markers, replace(state, expected=_moved(state.expected, markers), tracks=tracks)

    def _ellipses(self, state: ChainState, image: Image) -> tuple[Ellipses, tracking.Tracks | None]:
        """The markers' ellipses in the image, and what finds them in the next."""
        if isinstance(image, Sighting) and image.ellipses is not None:
            return image.ellipses, None
        return tracking.follow(
            image,
            state.tracks,
            self._circles,
            min_radius_px=self._smallest_px,
            settings=self.settings,
        )

    def enough(self, markers: Markers) -> Status:
        """Judge whether so many markers were seen that the shape is no guess.

        Args:
            markers: What was seen.

        Returns:
            "ok", or why not.
        """
        seen = len(markers)
        if self.estimator.are_enough(seen):
            return OK
        text = f"only {seen} of {self.design.markers.count} markers seen"
        return Status(StatusCode.TOO_FEW_MARKERS, text)

    def feel(
        self,
        state: ChainState,
        markers: Markers,
        surface: Surface,
        time: float,
        reading: PressureReading | None = None,
    ) -> tuple[Touch, ChainState]:
        """Find force, contact and slip from markers and surface.

        Args:
            state: What the image before left, with both references.
            markers: What was seen.
            surface: The membrane's shape through them.
            time: Of the image's capture, s.
            reading: Newest reading of the chamber's pressure gauge; None: there is none.

        Returns:
            The touch, as old as the image, and the state for the next.

        Raises:
            DeviceError: The rest reference is missing.
        """
        if state.reference is None:
            raise DeviceError(f"sensor {self.design.name}: markers before the rest reference")
        unknown = Touch(time, 0.0, np.nan, np.nan, False, surface=surface, markers=markers)
        if (status := self.enough(markers)) != OK:
            return replace(unknown, status=status), state
        reference = state.reference
        if state.rubber is not None:
            rest = self.inverse.at_rest(replace(reference.rest, faded=state.rubber.total))
            reference = replace(reference, rest=rest)
            state = replace(state, reference=reference)
        estimate = self.estimator.estimate(state, reference, markers, time, reading)
        unknown = replace(unknown, markers=estimate.markers)
        if not self.estimator.is_explained(estimate.shape):
            state = self._lost(estimate.state)
            status = self._why_lost(state)
            lost = slip.unknown(status.code, "shape not explained")
            return replace(unknown, slip=lost, status=status), state
        if self.inverse.rubber is not None and state.rubber is not None:
            scale = estimate.rest.young
            rubber = self.inverse.rubber.after(state.rubber, estimate.shape.c, scale, time)
            estimate = replace(estimate, state=replace(estimate.state, rubber=rubber))
        moved = estimate.rest.pressure_gauge - reference.rest.pressure_gauge
        moved = moved if math.isfinite(moved) else 0.0  # no gauge
        traction = self._traction(estimate, moved, time)
        return self._judge(replace(unknown, traction=traction), traction, estimate, moved)

    def _lost(self, state: ChainState) -> ChainState:
        """After an image that nothing explains. The next one begins where the last that something
        did left off (a torn picture is gone then), unless that is long ago."""
        shape = state.shape
        force = state.lost_at
        if force is None and shape is not None:
            force = self.inverse.force(shape)
        missed = state.unexplained + 1
        if missed > self.settings.inverse.remembered_images:
            shape = None
        return replace(state.without_history(), shape=shape, unexplained=missed, lost_at=force)

    def _why_lost(self, state: ChainState) -> Status:
        """What an image that nothing explains says: one of several after a large force was too much
        of it."""
        force = state.lost_at
        most = self.settings.inverse.overload_least
        if force is None or state.unexplained < _OVERLOADS_SURE or np.linalg.norm(force) < most:
            return Status(StatusCode.NO_SHAPE, "the markers fit no membrane shape")
        return Status(
            StatusCode.OVERLOADED,
            "overloaded: the markers fit no membrane shape since they showed "
            f"{-force[2]:.1f} N of pressing and {np.hypot(force[0], force[1]):.1f} N of shear",
        )

    def _traction(self, estimate: Estimate, moved: float, time: float) -> Traction:
        """The tractions, as a measured force scale has them; `moved` Pa by which the chamber's
        pressure has changed."""
        before = estimate.state.detection
        elapsed = math.inf if before is None else time - before.time
        traction = self.inverse.traction(estimate.shape, estimate.state.shape, elapsed, moved)
        if estimate.other is not None:
            other = self.inverse.traction(estimate.other).wrench - traction.wrench
            traction = replace(traction, wrench_cov=traction.wrench_cov + np.outer(other, other))
        force = self._measured.force
        return traction if force is None else force.apply(traction)

    def _patches(self, estimate: Estimate) -> tuple[Contact, ...]:
        """Where it is touched, with the forces as a measured force scale has them."""
        patches = find_patches(self.inverse, estimate.shape, estimate.rest, self.settings.patches)
        force = self._measured.force
        if force is None:
            return patches
        return tuple(replace(patch, force=force.scale * patch.force) for patch in patches)

    def _judge(
        self, touch: Touch, traction: Traction, estimate: Estimate, moved: float
    ) -> tuple[Touch, ChainState]:
        """Whether it is touched, where, and whether it slips; or what is doubtful about it."""
        s = self.settings
        state = estimate.state
        shape = estimate.shape
        before = state.detection
        found = zero.detect_touch(touch.time, traction, before, s.zero)
        patches = self._patches(estimate) if found.touching else ()
        judged, history = slip.judge(touch.time, self.inverse, shape, patches, state.slip, s.slip)
        state = replace(
            state, shape=shape, detection=found, slip=history, unexplained=0, lost_at=None
        )
        quiet = (
            before is not None
            and not found.touching
            and found.time - found.quiet_since > s.zero.quiet
        )
        if quiet and before is not None:
            state = self._with_zero_followed(state, estimate, found.time - before.time)
        sd = float(np.sqrt(traction.wrench_cov[2, 2]))
        if abs(moved) > s.gauge.moved_most:
            text = f"the chamber's pressure has moved by {moved:+.0f} Pa since the last image"
            status = Status(StatusCode.AIR_MOVES, text)
            lost = slip.unknown(status.code, "the air moves")
            return replace(touch, slip=lost, status=status), state
        pulled = found.force < -max(s.zero.pull_most, s.zero.touch_sd * sd)
        if quiet and (pulled or shape.drift > s.zero.drift_most):
            status = Status(
                StatusCode.REFERENCE_LOST,
                "the membrane seems pulled, or shifted: the rest reference is lost (temperature, "
                "camera)",
            )
            lost = slip.unknown(status.code, "no zero")
            return replace(touch, slip=lost, status=status), state
        felt = replace(
            touch,
            force_normal=found.force,
            force_normal_sd=sd,
            touching=found.touching,
            contact=together(patches, (len(traction.y), len(traction.x))),
            patches=patches,
            slip=judged,
        )
        return felt, state

    def _with_zero_followed(
        self, state: ChainState, estimate: Estimate, elapsed: float
    ) -> ChainState:
        """The rest reference follows a membrane that nothing has touched for a while."""
        if state.reference is None:
            return state
        rest = estimate.rest
        followed = zero.follow(
            self.inverse,
            zero.Zero.of(rest) if state.apart is None else zero.Zero(rest, state.apart),
            estimate.shape,
            estimate.markers,
            elapsed,
            self.settings.zero,
        )
        return replace(
            state,
            reference=replace(state.reference, rest=followed.rest),
            apart=followed.apart,
            gas=None if state.gas is None else state.gas.corrected(followed.share),
        )

    def _locate(self, state: ChainState, image: Image, expected: Array, what: str) -> Markers:
        self._require_levels(image, what)
        markers, _ = self.see(replace(state, expected=expected, reference=None), image)
        self._require(markers, what)
        return markers

    def _require_levels(self, image: Image, what: str) -> None:
        """Raise DeviceError for a picture that is white around most circles: how large they are
        changes with the light then."""
        if isinstance(image, Sighting):
            return
        settings = self.settings
        ellipses, _ = tracking.follow(
            image, None, self._circles, min_radius_px=self._smallest_px, settings=settings
        )
        if is_overexposed(grey_image(image), ellipses, "dark", settings.locate):
            raise DeviceError(
                f"sensor {self.design.name}: {what}: the picture is overexposed, white around "
                "most markers; less light, exposure or gain"
            )

    def _require(self, markers: Markers, what: str) -> None:
        """Raise DeviceError for too few markers, or places that are no numbers."""
        known = int(np.isfinite(markers.p_SM).all(axis=1).sum())
        if known < len(markers) or self.enough(markers) != OK:
            raise DeviceError(
                f"sensor {self.design.name}: {what}: only {known} of {self.design.markers.count} "
                "markers found; check lighting, focus and the sensor file"
            )


def _moved(expected: Array, markers: Markers) -> Array:
    """`expected` with the markers that were seen where they are now."""
    expected = expected.copy()
    expected[markers.ids] = markers.p_SM
    return expected


def _average(seen: Sequence[Markers]) -> Markers:
    """Mean of repeated measurements of markers at rest; a marker counts when at least half of them
    saw it."""
    count = np.bincount(np.concatenate([m.ids for m in seen]))
    total = np.zeros((len(count), 3))
    normal = np.zeros((len(count), 3))
    cov = np.zeros((len(count), 3, 3))
    dark = np.zeros(len(count))
    for m in seen:
        total[m.ids] += m.p_SM
        normal[m.ids] += m.n_S
        cov[m.ids] += m.cov_p
        dark[m.ids] += np.nan if m.darkness is None else m.darkness
    ids = np.flatnonzero(count >= len(seen) / 2)
    n = count[ids][:, None]
    direction = normal[ids] / np.linalg.norm(normal[ids], axis=1, keepdims=True)
    mean = dark[ids] / count[ids]
    darkness = mean if np.isfinite(mean).all() else None
    fiducials = [m.fiducials for m in seen if m.fiducials is not None]
    return Markers(
        ids,
        total[ids] / n,
        direction,
        cov[ids] / n[..., None] ** 2,
        darkness,
        fixed.average(fiducials) if fiducials else None,
    )
