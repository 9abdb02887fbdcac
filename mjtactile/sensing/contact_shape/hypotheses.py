"""Contact shape hypotheses of one contact episode, weighted by their evidence
(docs/theory/contact_shape.md, Eq. F19)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mjtactile.core.types import Array, ContactShape
from mjtactile.sensing.contact_shape.fit_state import Data
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.gauss_newton import Fit, exactly
from mjtactile.sensing.contact_shape.linear_update import Linearization
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.quadric_deviation import Deviation
from mjtactile.sensing.contact_shape.relative_motion import Track
from mjtactile.sensing.contact_shape.shape_filter import ShapeFilter
from mjtactile.sensing.contact_shape.shape_models import ShapeModel, kinds_of
from mjtactile.sensing.settings import ContactShapeSettings

_CLOSE = 2.5  # log evidence behind the best: a fit is refined before it is weighted
_HELD_FORCE = 1.15  # force ratio within which a contact is held
_HELD_MOTION = 5e-4  # motion of the contact within which it is held, m
_STANDS = 4  # maximum number of images during which a report stands
_SAME_FORCE = 1.05  # force ratio within which it stands
_SAME_POSITION = 3e-4  # motion of the contact within which it stands, m
_BEHIND = 10.0  # log evidence behind the best: the model is not searched again in this episode


@dataclass(frozen=True, eq=False)
class Candidate:
    """Shape model that may be the right one. It holds the `fit` of the last evaluation, and the log
    evidence of the images. The filter `common` combines the constant parameters over all
    evaluations. `behind` is the log evidence by which it trailed the best model when it was
    dropped. `possible` is the log evidence that it may have gained since then."""

    family: ShapeModel
    fit: Fit
    image_log: float
    common: ShapeFilter
    behind: float = 0.0
    possible: float = 0.0

    @property
    def log(self) -> float:
        """Log evidence: that of the images, less the penalty for a change of the constant
        parameters."""
        return self.image_log - self.common.drift / 2

    def without(self, best: Evaluation, noise: float) -> Candidate:
        """Return the candidate after an image that it was not fitted to. It is assumed to explain
        the image as well as the `best` fit, possibly within the marker noise."""
        image_log = self.image_log + best.share * best.fit.log_evidence_with(noise)
        possible = self.possible + best.share * best.fit.log_lacking_with(noise)
        return replace(self, image_log=image_log, possible=possible)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Fit to the newest image, with the history of its model. It holds the log evidence `image_log`
    and the filter `common`. The evidence of the new image is weighted by `share`."""

    fit: Fit
    image_log: float
    common: ShapeFilter
    share: float

    def exactly(self, forward: ForwardModel, data: Data, noise: float) -> Evaluation:
        """Return the evaluation with the shape's exact Jacobian."""
        return replace(self, fit=exactly(forward, self.fit, data, noise, times=0))

    def with_noise(self, noise: float) -> Candidate:
        """Return the candidate for marker variances multiplied by `noise`."""
        if not self.share:
            return Candidate(self.fit.family, self.fit, self.image_log, self.common)
        log = self.image_log + self.share * self.fit.log_evidence_with(noise)
        return Candidate(self.fit.family, self.fit, log, self.common.with_observation(self.fit))


@dataclass(frozen=True, eq=False)
class ReportedKind:
    """Kind of a contact, with force, N, and position (2,), m, at the image that chose it."""

    kind: str
    force: float
    position: Array

    def holds(self, force: float, position: Array) -> bool:
        """Return True if neither force nor position has changed since then: an image of a hold adds
        noise and no evidence."""
        ratio = force / max(self.force, 1e-9)
        moved = float(np.hypot(*(position - self.position)))
        return 1 / _HELD_FORCE < ratio < _HELD_FORCE and moved < _HELD_MOTION


@dataclass(frozen=True, eq=False)
class Report:
    """Reported `shape` of an image, with its force, N, and position (2,), m, and the number of
    `images` since then."""

    shape: ContactShape
    force: float
    position: Array
    images: int = 0

    def stands(self, force: float, position: Array) -> bool:
        """Return True if the report is recent and the load has hardly changed since then."""
        ratio = force / max(self.force, 1e-9)
        moved = float(np.hypot(*(position - self.position)))
        recent = self.images < _STANDS
        return recent and 1 / _SAME_FORCE < ratio < _SAME_FORCE and moved < _SAME_POSITION


@dataclass(frozen=True, eq=False)
class PressHistory:
    """Shape estimate from the images of one contact episode.

    Attributes:
        candidates: Possible models; first the most likely model of the most likely kind.
        now: Fit of the first candidate to the newest image.
        noise: Factor on the marker variances from the best fit of the last evaluation.
        force: Estimated force at the last evaluation, N.
        loads: Minimum and maximum force of the evaluations that added evidence, N.
        images: Number of images since the last evaluation.
        parts: Number of contact patches then.
        search_misfit: Mean square misfit at the last search over all models.
        search_force: Estimated force then, N.
        track: Poses of the shape in the last images.
        dropped: Models that were dropped, in their last state.
        reported: Reported kind, and the load with which it was chosen.
        other: Deviation of the object from the reported model, at the last evaluation.
        linear: Linear model that gave `now`; None: `now` has its own membrane solution.
        shown: Last report; None: none yet.
    """

    candidates: tuple[Candidate, ...]
    now: Fit
    noise: float
    force: float
    loads: tuple[float, float]
    images: int
    parts: int
    search_misfit: float
    search_force: float
    track: Track = ()
    dropped: tuple[Candidate, ...] = ()
    reported: ReportedKind | None = None
    other: Deviation | None = None
    linear: Linearization | None = None
    shown: Report | None = None

    @property
    def solved(self) -> Fit:
        """Last fit of the first candidate with a membrane solution."""
        return self.now if self.linear is None else self.linear.fit

    @cached_property
    def probabilities(self) -> Array:
        """(n,) of the candidates."""
        logs = np.array([candidate.log for candidate in self.candidates])
        fraction = np.exp(logs - logs.max())
        return fraction / fraction.sum()

    def kinds(self, names: tuple[str, ...]) -> dict[str, float]:
        """Return the probabilities of the kinds `names`."""
        return dict.fromkeys(names, 0.0) | self._kinds

    @cached_property
    def _kinds(self) -> dict[str, float]:
        """Probabilities of the kinds that the candidates may be."""
        sums: dict[str, float] = {}
        for probability, fit in self.bodies:
            for kind, fraction in kinds_of(fit.family, fit.theta, fit.cov_with(self.noise)).items():
                sums[kind] = sums.get(kind, 0.0) + probability * fraction
        return sums

    def adds_evidence(self, force: float) -> bool:
        """Return True if no evaluation had about this force. At the same force, errors of membrane
        and shape model repeat."""
        minimum, maximum = self.loads
        return not minimum / _HELD_FORCE < force < maximum * _HELD_FORCE

    @property
    def behind(self) -> dict[str, float]:
        """Log evidence of the models in this contact episode, behind the best."""
        known = (*self.candidates, *self.dropped)
        return {candidate.family.name: -candidate.behind for candidate in known}

    def near(self, families: Sequence[ShapeModel]) -> list[ShapeModel]:
        """Return those of `families` whose evidence is not far behind in this contact episode."""
        known = (*self.candidates, *self.dropped)
        close = {candidate.family.name for candidate in known if candidate.behind < _BEHIND}
        return [family for family in families if family.name in close]

    @cached_property
    def bodies(self) -> list[tuple[float, Fit]]:
        """Probability and fit of each candidate. The fit is the newest one for the most likely
        candidate. For the others it comes from the last evaluation of all candidates."""
        fits = [self.now, *(candidate.fit for candidate in self.candidates[1:])]
        return list(zip(self.probabilities.tolist(), fits, strict=True))


def weigh(
    forward: ForwardModel,
    found: list[Evaluation],
    hint: InitialGuess,
    data: Data,
    s: ContactShapeSettings,
    past: PressHistory | None = None,
) -> PressHistory | None:
    """Weigh the fits of an image by evidence. Dropped models are kept together with those in
    `past`. The residual of the best fit, an error of membrane model and simulator, is treated as
    noise of all models. So no model wins by a chi-square of hundreds over another equally wrong
    one."""
    if not found:
        return None
    noise = max(s.noise_min, min(candidate.fit.misfit for candidate in found))
    roughly = [candidate.with_noise(noise) for candidate in found]
    maximum = max(candidate.log for candidate in roughly)
    minimum = maximum - s.log_lost
    both = zip(found, roughly, strict=True)
    likely = [(candidate, rough) for candidate, rough in both if rough.log > minimum]
    kept = [
        candidate.exactly(forward, data, noise).with_noise(noise)
        if rough.log > maximum - _CLOSE
        else rough
        for candidate, rough in likely
    ]
    kept.sort(key=lambda candidate: -candidate.log)
    best = _best(kept, noise)
    dropped = [
        replace(candidate, behind=maximum - candidate.log)
        for candidate in roughly
        if not candidate.log > minimum
    ]
    if past is not None:
        seen = {candidate.family.name for candidate in roughly}
        before = (*past.dropped, *past.candidates)
        likeliest = max(found, key=lambda candidate: candidate.fit.log_evidence_with(noise))
        dropped += [
            candidate.without(likeliest, noise)
            for candidate in before
            if candidate.family.name not in seen
        ]
    kept.remove(best)
    added = (data.force, data.force)
    if past is not None:
        forces = (*past.loads, data.force) if found[0].share else past.loads
        added = (min(forces), max(forces))
    now = exactly(forward, best.fit, data, noise)
    best = replace(best, fit=now)
    return PressHistory(
        (best, *kept),
        now,
        noise,
        data.force,
        added,
        0,
        len(hint.parts),
        best.fit.misfit,
        data.force,
        dropped=tuple(dropped),
    )


def _best(candidates: list[Candidate], noise: float) -> Candidate:
    """Return the most likely candidate of the most likely kind."""
    maximum = candidates[0].log
    sums: dict[str, float] = {}
    weights = []
    for candidate in candidates:
        kinds = kinds_of(candidate.family, candidate.fit.theta, candidate.fit.cov_with(noise))
        weighted = {
            kind: fraction * math.exp(candidate.log - maximum) for kind, fraction in kinds.items()
        }
        weights.append(weighted)
        for kind, weight in weighted.items():
            sums[kind] = sums.get(kind, 0.0) + weight
    kind = max(sums, key=lambda name: sums[name])
    return candidates[max(range(len(weights)), key=lambda n: weights[n].get(kind, 0.0))]
