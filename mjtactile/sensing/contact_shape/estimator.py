"""Estimation of the contact shape.

Each shape model is fitted to the images of a touch and weighted by its evidence. The result
includes its uncertainty (docs/theory/contact_shape.md, Eq. F18-F20).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.status import OK, Status, StatusCode
from mjtactile.core.types import SHAPES, Array, Contact, ContactShape, Touch
from mjtactile.sensing.contact_shape.amortized_start import AmortizedStart, Proposal
from mjtactile.sensing.contact_shape.contact_area import (
    area_sd,
    areas,
    interval,
    resolves_kind,
    rim_areas,
)
from mjtactile.sensing.contact_shape.fit_state import Data
from mjtactile.sensing.contact_shape.force_fusion import ContactLoad, contact_load, tip_probability
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.hypotheses import PressHistory, Report, ReportedKind
from mjtactile.sensing.contact_shape.initial_search import Suggestions
from mjtactile.sensing.contact_shape.press_tracker import follow
from mjtactile.sensing.contact_shape.primitives import (
    EDGE,
    ROUNDING,
    InitialGuess,
    feasible_half_extents,
)
from mjtactile.sensing.contact_shape.quadric_deviation import deviation
from mjtactile.sensing.contact_shape.relative_motion import MembraneMotion, motion, tracked
from mjtactile.sensing.contact_shape.shape_models import FAMILIES, kinds_of
from mjtactile.sensing.contact_shape.shape_result import (
    build_shape,
    with_curvature_spread,
    with_position_spread,
    with_tip,
)
from mjtactile.sensing.contact_shape.start_files import reference_guess
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from mjtactile.sensing.settings import DEFAULTS, ContactShapeSettings, Settings

_MAX_PARTS = 3  # simultaneous contacts
_PART_FRACTION = 0.12  # minimum force fraction of a separate part; nearly all patches exceed it


@dataclass(frozen=True, eq=False)
class Found:
    """Contact shape result of one image. It holds the `shape`, its `load` (None: the shape is
    unknown), and the history for the next image."""

    shape: ContactShape
    load: ContactLoad | None
    press: PressHistory | None


class ContactShapeEstimator:
    """Contact shape estimator of one sensor, made once per rest reference. `gauge_pressure` is the
    approximate gauge pressure at rest, Pa; None: taken from `rest`. `start` estimates the start of
    the fits; None: it is searched."""

    def __init__(
        self,
        design: SensorDesign,
        rest: InverseRest,
        gauge_pressure: float | None = None,
        settings: Settings = DEFAULTS,
        start: AmortizedStart | None = None,
    ):
        self.settings = settings
        self.start = start
        self._frame = feasible_half_extents(design.frame, EDGE)
        self.forward = ForwardModel(design, rest, settings.contact_shape.spacing, gauge_pressure)

    def find(self, touches: Sequence[Touch], p_rest: Array) -> ContactShape:
        """Estimate the contact shape in the newest of the touches of one contact episode, oldest
        first. `p_rest` (N, 3), m, are the marker positions at rest. The shape is "unknown", with a
        status, if it cannot be estimated."""
        found = Found(_unknown(Status(StatusCode.INCOMPLETE_DATA, "no image")), None, None)
        for touch in touches:
            found = self.follow(touch, found.press, p_rest)
        return found.shape

    def follow(
        self,
        touch: Touch,
        press: PressHistory | None,
        p_rest: Array,
        rubber: MembraneMotion | None = None,
        *,
        with_load: bool = True,
    ) -> Found:
        """Estimate the contact shape in the next image. `press` is the history of the contact
        episode, `p_rest` (N, 3), m, are the marker positions at rest, and `rubber` is the motion of
        the rubber since the previous image (None: unknown). `with_load`: False for the shape
        without its motion and load."""
        s = self.settings.contact_shape
        lacking = uninformative_status(touch, s)
        if lacking is not None:
            goes_on = touch.touching or touch.status != OK
            return Found(lacking, None, press if goes_on else None)
        assert touch.contact is not None
        position = np.array(touch.contact.centroid)
        shown = None if press is None or with_load else press.shown
        if press is not None and shown is not None and shown.stands(touch.force_normal, position):
            press = replace(press, shown=replace(shown, images=shown.images + 1))
            return Found(shown.shape, None, press)
        inverse = self.settings.inverse
        drift = (inverse.drift_gas, inverse.drift_camera)
        raised = p_rest[:, 2] - self.forward.rest_heights
        data = Data.of(touch, raised, self.forward.by_gas, s, drift)
        track = () if press is None else press.track
        before = None if press is None else press.reported
        suggest = None if self.start is None else cache(self._suggest)
        press = follow(self.forward, press, self._hint(touch), data, s, suggest)
        if press is None:
            text = "no shape model fits"
            return Found(_unknown(Status(StatusCode.FIT_FAILED, text)), None, None)
        scale = max(s.noise_min, press.now.misfit)
        if press.images == 0:  # the object is the same until the next evaluation
            press = replace(press, other=deviation(self.forward, press.now, data, scale))
        reported = self._kind(press, before, data.force, position)
        shape = self._result(press, reported.kind, scale, touch.contact)
        press = replace(press, reported=reported, shown=Report(shape, data.force, position))
        if not with_load:
            return Found(shape, None, press)
        track = tracked(track, press.now, touch.time, rubber, scale, s)
        relative = motion(track, press.now, slips=slips(touch))
        load = None
        if shape.kind != "unknown" and touch.traction is not None:
            load = contact_load(self.forward, press, touch.traction.wrench, scale, s)
        return Found(replace(shape, motion=relative), load, replace(press, track=track))

    def _suggest(self, data: Data) -> Suggestions:
        """Return the starts of the shape models for an image. They are estimated for a membrane
        without friction: the heights due to shear are removed first."""
        assert self.start is not None
        raised = data.heights - self.forward.rest_heights[data.ids]
        proposal = self.start.propose(raised, data.ids)
        if data.shear is not None:
            raised = raised - self._raised_by_shear(data, data.shear, proposal)[data.ids]
            proposal = self.start.propose(raised, data.ids)
        return Suggestions(proposal, self.reference)

    def _raised_by_shear(self, data: Data, shear: Array, proposal: Proposal) -> Array:
        """Return the rise of the markers (N,), m, by the shear on a ball at the contact."""
        ball = FAMILIES["ball"].rows(proposal.theta("ball")[None], self.reference)
        without = self.forward.solve(ball)
        sheared = None if without is None else self.forward.solve(ball, without, shear)
        if without is None or sheared is None:
            return np.zeros(len(self.forward.rest_heights))
        return self.forward.heights(sheared.x[None])[0] - self.forward.heights(without.x[None])[0]

    @cached_property
    def reference(self) -> InitialGuess:
        """Guess that suggested parameters are relative to."""
        return reference_guess(self.forward)

    def _kind(
        self, press: PressHistory, before: ReportedKind | None, force: float, position: Array
    ) -> ReportedKind:
        """Return the kind to report. It is that of `before` while the contact is held, if the
        fitted model allows it."""
        probabilities = press.kinds((*SHAPES,))
        if before is not None and before.holds(force, position):
            own = kinds_of(press.now.family, press.now.theta, press.now.cov_with(press.noise))
            if before.kind in (*own, "unknown"):
                return before
        kind = max(probabilities, key=lambda name: probabilities[name])
        unexplained = press.now.misfit > self.settings.contact_shape.misfit_max
        return ReportedKind("unknown" if unexplained else kind, force, position)

    def _result(self, press: PressHistory, kind: str, scale: float, nodal: Contact) -> ContactShape:
        s = self.settings.contact_shape
        probabilities = press.kinds((*SHAPES,))
        misfit = press.now.misfit
        if kind == "unknown":
            text = (
                f"no shape model explains the markers of this load: misfit {misfit:.1f}, maximum "
                f"{s.misfit_max:g}"
            )
            return _unknown(Status(StatusCode.FIT_FAILED, text), probabilities, misfit)
        weighed = []
        own = max(1.0, misfit)  # without the model error, which `area_sd` adds
        for probability, found in press.bodies:
            total = sum(areas(self.forward, found, s))
            weighed.append((probability, total, area_sd(found, total, own, s)))
        spread = scale * press.candidates[0].common.variance_factor
        other = press.other
        if other is not None:
            weighed[0] = other.with_area(*weighed[0])
        growth = press.candidates[0].common.growth
        weighed[:1] = rim_areas(press.now, growth, *weighed[0])
        sizes = (weighed[0][1], interval(weighed))
        if kind == "flat" and not resolves_kind(sizes[0], s):  # it may be a round object
            ends = np.array([sizes[1], nodal.area_interval])
            sizes = (nodal.area, (float(ends[:, 0].min()), float(ends[:, 1].max())))
        shape = build_shape(self.forward, press.now, kind, probabilities, spread, sizes, s, other)
        sharp = probabilities["edge"] + probabilities["point"]
        shape = with_curvature_spread(shape, press.bodies, sharp)
        shape = with_position_spread(shape, press.bodies[1:])
        return with_tip(shape, tip_probability(press.now, spread, s))

    def _hint(self, touch: Touch) -> InitialGuess:
        assert touch.contact is not None
        total = self._hint_at(touch, touch.contact, touch.force_normal)
        firm = [
            patch
            for patch in touch.patches[:_MAX_PARTS]
            if -patch.force[2] > _PART_FRACTION * touch.force_normal
        ]
        if len(firm) < 2:
            return total
        parts = tuple(self._hint_at(touch, patch, -float(patch.force[2])) for patch in firm)
        return replace(total, parts=parts)

    def _hint_at(self, touch: Touch, contact: Contact, force: float) -> InitialGuess:
        surface = touch.surface
        height = 0.0
        if surface is not None:
            column = int(np.abs(surface.x - contact.centroid[0]).argmin())
            row = int(np.abs(surface.y - contact.centroid[1]).argmin())
            height = float(surface.z[row, column])
        forward = self.forward
        design = forward.membrane.design
        angle = contact.angle if math.isfinite(contact.angle) else 0.0
        return InitialGuess(
            np.array(contact.centroid),
            height + design.membrane.thickness / 2,
            contact.area,
            angle,
            self._frame,
            forward.nodes,
            ROUNDING * forward.spacing,
            force,
            round=design.frame.outline is not None,
        )


def slips(touch: Touch) -> bool:
    """Return True if the touch is classified as slipping."""
    return touch.slip is not None and touch.slip.state == "slipping"


def uninformative_status(touch: Touch, s: ContactShapeSettings) -> ContactShape | None:
    """Return an unknown shape if the image cannot determine one, else None."""
    if touch.status != OK or touch.contact is None or touch.markers is None:
        return _unknown(Status(StatusCode.INCOMPLETE_DATA, f"no touch: {touch.status}"))
    if not touch.touching or touch.force_normal < s.force_min:
        return _unknown(Status(StatusCode.FORCE_TOO_LOW, f"normal force below {s.force_min:g} N"))
    return None


def _unknown(
    status: Status, probabilities: dict[str, float] | None = None, misfit: float = math.nan
) -> ContactShape:
    return ContactShape(
        "unknown",
        dict.fromkeys(SHAPES, math.nan) if probabilities is None else probabilities,
        status=status,
        misfit=misfit,
    )
