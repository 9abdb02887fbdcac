"""Contact, contact position and slip from an estimate, or a status that explains why it is
unreliable."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mjtactile.core.calibration_parts import ForceScale
from mjtactile.core.status import Status, StatusCode
from mjtactile.core.types import Contact, Touch, Traction
from mjtactile.sensing.estimate import Estimate
from mjtactile.sensing.force import contact_detection
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.pipeline_state import PipelineState
from mjtactile.sensing.settings import Settings
from mjtactile.sensing.touch import slip
from mjtactile.sensing.touch.patches import find_patches, together
from mjtactile.sensing.wide_face import size_deviation

_OVERLOADS_SURE = 2  # images in a row: a single torn image is not an overload


class ContactDecision:
    """Evaluation of the estimates of one sensor. Stateless. `force` is the measured force scale;
    None: not measured."""

    def __init__(self, inverse: InverseMembrane, force: ForceScale | None, settings: Settings):
        self._inverse = inverse
        self._area = inverse.design.frame.area
        self._force = force
        self._settings = settings

    def lost(self, state: PipelineState) -> PipelineState:
        """Return the state after an image that no membrane shape explains. The next image starts
        from the last explained one, because a torn image is gone by then. After too many
        unexplained images it starts without a shape."""
        shape = state.shape
        force = state.lost_at
        if force is None and shape is not None:
            force = self._inverse.force(shape)
        missed = state.unexplained + 1
        if missed > self._settings.inverse.remembered_images:
            shape = None
        return replace(state.without_history(), shape=shape, unexplained=missed, lost_at=force)

    def failure_status(self, state: PipelineState) -> Status:
        """Return the status of an image that no membrane shape explains. Several such images in a
        row after a large force mean an overload."""
        force = state.lost_at
        maximum = self._settings.inverse.overload_min
        if force is None or state.unexplained < _OVERLOADS_SURE or np.linalg.norm(force) < maximum:
            return Status(StatusCode.FIT_FAILED, "the markers fit no membrane shape")
        return Status(
            StatusCode.OVERLOADED,
            "overloaded: the markers fit no membrane shape after a normal force of "
            f"{-force[2]:.1f} N and a shear force of {np.hypot(force[0], force[1]):.1f} N",
        )

    def traction(self, estimate: Estimate, moved: float, time: float) -> Traction:
        """Return the tractions, scaled by a measured force scale. `moved` is the change of the
        chamber pressure, Pa."""
        before = estimate.state.detection
        elapsed = math.inf if before is None else time - before.time
        blend = estimate.state.blend
        traction = self._inverse.traction(
            estimate.shape,
            estimate.state.shape,
            elapsed,
            moved,
            0.0 if blend is None else blend.images,
        )
        if estimate.other is not None:
            other = self._inverse.traction(estimate.other).wrench - traction.wrench
            traction = replace(
                traction,
                wrench_cov=traction.wrench_cov + estimate.other_weight * np.outer(other, other),
            )
        cov = traction.wrench_cov.copy()
        cov[2, 2] += self._unbalanced(estimate, traction) ** 2
        traction = replace(traction, wrench_cov=cov)
        force = self._force
        return traction if force is None else force.apply(traction)

    def _unbalanced(self, estimate: Estimate, traction: Traction) -> float:
        """Return the force, N, by which the pressure sensor contradicts the estimated shape. A flat
        contact carries the gauge pressure times its area. The area follows from force and estimated
        pressure, and is at most that of the frame. The part of the frame that the contact may cover
        besides is as uncertain as the pressure."""
        pressure = max(estimate.shape.gauge_pressure, 1.0)
        flat = abs(float(traction.wrench[2])) / pressure
        unseen = self._area * abs(estimate.pressure_gap) / pressure
        area = min(flat + unseen, self._area)
        return abs(estimate.pressure_gap) * area

    def _patches(self, estimate: Estimate) -> tuple[Contact, ...]:
        """Return the contact patches, with forces corrected by the measured force scale."""
        patches = find_patches(self._inverse, estimate.shape, estimate.rest, self._settings.patches)
        force = self._force
        if force is None:
            return patches
        return tuple(replace(patch, force=force.scale * patch.force) for patch in patches)

    def _problem(
        self,
        estimate: Estimate,
        traction: Traction,
        found: contact_detection.Detection,
        sd: float,
        moved: float,
        *,
        quiet: bool,
    ) -> tuple[Status, str] | None:
        """Return the status of an unreliable estimate, and the reason for an unknown slip."""
        s = self._settings
        if abs(moved) > s.gas_filter.moved_max:
            text = f"the chamber pressure has changed by {moved:+.0f} Pa since the last image"
            return Status(StatusCode.PRESSURE_CHANGING, text), "the pressure is changing"
        if estimate.on_frame:
            text = "a face wider than the frame rests on it; the frame carries a part of the load"
            return Status(StatusCode.INCONSISTENT, text), "a face rests on the frame"
        deviation = size_deviation(estimate.shape)
        unmeasured = estimate.state.face is not None and estimate.state.gas is None
        if unmeasured and deviation > s.inverse.face_size_max:
            text = (
                "the circle sizes contradict the membrane under a face wider than the frame by "
                f"{deviation:.1f} standard deviations, and no pressure sensor decides"
            )
            return Status(StatusCode.INCONSISTENT, text), "no balance"
        gap = self._unbalanced(estimate, traction)
        if gap > s.inverse.gap_max * abs(found.force) and gap > s.zero.touch_min:
            text = (
                f"the pressure sensor reads {estimate.pressure_gap:+.0f} Pa relative to the "
                f"estimated membrane shape, {gap:.2g} N of force"
            )
            return Status(StatusCode.INCONSISTENT, text), "no balance"
        pulled = found.force < -max(s.zero.pull_max, s.zero.touch_sd * sd)
        if quiet and (pulled or estimate.shape.drift > s.zero.drift_max):
            text = (
                "the membrane appears pulled or shifted: the rest reference is lost "
                "(temperature, camera)"
            )
            return Status(StatusCode.REFERENCE_LOST, text), "no zero"
        return None

    def evaluate(
        self, touch: Touch, traction: Traction, estimate: Estimate, moved: float
    ) -> tuple[Touch, PipelineState]:
        """Decide on contact, contact position and slip, or set a status if the estimate is
        unreliable."""
        s = self._settings
        state = estimate.state
        shape = estimate.shape
        before = state.detection
        found = contact_detection.detect_touch(touch.time, traction, before, s.zero)
        patches = self._patches(estimate) if found.touching else ()
        slip_state, history = slip.classify(
            touch.time, self._inverse, shape, patches, state.slip, s.slip
        )
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
        problem = self._problem(estimate, traction, found, sd, moved, quiet=quiet)
        if problem is not None:
            status, reason = problem
            lost = slip.unknown(status.code, reason)
            return replace(touch, traction=None, slip=lost, status=status), state
        known = sd if found.touching else max(sd, self._min_force(state))
        estimated = replace(
            touch,
            force_normal=found.force,
            force_normal_sd=known,
            touching=found.touching,
            contact=together(patches, (len(traction.y), len(traction.x))),
            patches=patches,
            slip=slip_state,
        )
        return estimated, state

    @staticmethod
    def _min_force(state: PipelineState) -> float:
        """Return the minimum detectable force of this sensor, N.

        A membrane that is too stiff for its camera hardly moves: the prior of the tractions, not
        the image, then bounds the estimated force and its standard deviation.
        """
        return 0.0 if state.reference is None else state.reference.min_force

    def _with_zero_followed(
        self, state: PipelineState, estimate: Estimate, elapsed: float
    ) -> PipelineState:
        """Return the state with the rest reference updated to a membrane without recent contact."""
        if state.reference is None:
            return state
        rest = estimate.rest
        followed = contact_detection.follow(
            self._inverse,
            contact_detection.RestTracker.of(rest)
            if state.offsets is None
            else contact_detection.RestTracker(rest, state.offsets),
            estimate.shape,
            estimate.markers,
            elapsed,
            self._settings.zero,
        )
        return replace(
            state,
            reference=replace(state.reference, rest=followed.rest),
            offsets=followed.offsets,
            gas=None if state.gas is None else state.gas.corrected(followed.fraction),
        )
