"""What the images of a press have told: families that may be it, weighed by their evidence
(docs/theory/contact_shape.md, Eq. F19)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.types import Array
from mjtactile.sensing.contact_shape.fit_state import Data
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.gauss_newton import Fit, exactly
from mjtactile.sensing.contact_shape.initial_search import Films
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.relative_motion import Track
from mjtactile.sensing.contact_shape.shape_filter import ShapeFilter
from mjtactile.sensing.contact_shape.shape_models import ShapeModel, kinds_of
from mjtactile.sensing.settings import ContactShapeSettings

_BEHIND = 10.0  # of the log of evidence: a family that is not looked for again in a press


@dataclass(frozen=True, eq=False)
class Candidate:
    """A family that may be it: its `fit` at the last look, the `log` of the images' evidence so
    far, what all looks have told of what it keeps, and by how much it was `behind` the likeliest
    when it was given up."""

    family: ShapeModel
    fit: Fit
    image_log: float
    common: ShapeFilter
    behind: float = 0.0

    @property
    def log(self) -> float:
        """Of its evidence: the images', and that it stayed the same."""
        return self.image_log - self.common.drift / 2


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A body of the newest image, with what was known before: the `image_log` of its family's
    evidence and what its looks had in common; the image's own evidence counts by a `share`."""

    fit: Fit
    image_log: float
    common: ShapeFilter
    share: float

    def exactly(self, forward: ForwardModel, data: Data, noise: float) -> Evaluation:
        """With the body's exact slopes."""
        return replace(self, fit=exactly(forward, self.fit, data, noise))

    def with_noise(self, noise: float) -> Candidate:
        """As a candidate, where the markers' variances are `noise` times what is believed."""
        log = self.image_log + self.share * self.fit.log_evidence_with(noise)
        return Candidate(self.fit.family, self.fit, log, self.common.with_observation(self.fit))


@dataclass(frozen=True, eq=False)
class PressHistory:
    """What the images of a press have told.

    Attributes:
        candidates: The families that may be it; first the likeliest of the likeliest kind.
        now: The first one's body in the newest image.
        noise: Of the markers' variances, what the best left at the last look.
        force: N, felt at the last look.
        images: Since the last look.
        parts: Places where it was touched then.
        doubted: Mean square misfit when all families were looked for.
        track: Where the body stood in the last images.
        left: Families that were given up, as they were then.
    """

    candidates: tuple[Candidate, ...]
    now: Fit
    noise: float
    force: float
    images: int
    parts: int
    doubted: float
    track: Track = ()
    left: tuple[Candidate, ...] = ()

    @property
    def probabilities(self) -> Array:
        """(n,) of the candidates."""
        logs = np.array([one.log for one in self.candidates])
        share = np.exp(logs - logs.max())
        return share / share.sum()

    def kinds(self, names: tuple[str, ...]) -> dict[str, float]:
        """Probabilities of the kinds `names`."""
        sums = dict.fromkeys(names, 0.0)
        for probability, fit in self.bodies():
            for kind, share in kinds_of(fit.family, fit.theta, fit.cov_with(self.noise)).items():
                sums[kind] += probability * share
        return sums

    def near(self, families: Sequence[ShapeModel]) -> list[ShapeModel]:
        """Those of `families` that are not far behind by what the press has told."""
        known = (*self.candidates, *self.left)
        close = {one.family.name for one in known if one.behind < _BEHIND}
        return [family for family in families if family.name in close]

    def bodies(self) -> list[tuple[float, Fit]]:
        """Each candidate's probability and body: the newest of the likeliest, of the others that of
        the last look."""
        fits = [self.now, *(one.fit for one in self.candidates[1:])]
        return list(zip(self.probabilities.tolist(), fits, strict=True))


def weighed(
    films: Films,
    found: list[Evaluation],
    hint: InitialGuess,
    data: Data,
    s: ContactShapeSettings,
    past: PressHistory | None = None,
) -> PressHistory | None:
    """Bodies of an image, weighed; those that are given up, with those that were in the `past`, are
    remembered.

    What even the best leaves of the markers is the film's and the simulator's doing: it is taken
    for noise, the same for all families, so that none wins by chi-squares of hundreds over another
    that is as wrong.
    """
    if not found:
        return None
    noise = max(s.noise_min, min(one.fit.misfit for one in found))
    roughly = [one.with_noise(noise) for one in found]
    most = max(one.log for one in roughly)
    least = most - s.log_lost
    likely = [one for one, rough in zip(found, roughly, strict=True) if rough.log > least]
    kept = [one.exactly(films.fine, data, noise).with_noise(noise) for one in likely]
    kept.sort(key=lambda one: -one.log)
    spoken = _spoken(kept, noise)
    lost = [replace(one, behind=most - one.log) for one in roughly if not one.log > least]
    if past is not None:
        seen = {one.family.name for one in roughly}
        before = (*past.left, *past.candidates)
        lost += [one for one in before if one.family.name not in seen]
    kept.remove(spoken)
    return PressHistory(
        (spoken, *kept), spoken.fit, noise, data.force, 0, len(hint.parts), 0.0, left=tuple(lost)
    )


def _spoken(candidates: list[Candidate], noise: float) -> Candidate:
    """The likeliest of the likeliest kind."""
    most = candidates[0].log
    shares = [
        {
            kind: share * math.exp(one.log - most)
            for kind, share in kinds_of(one.family, one.fit.theta, one.fit.cov_with(noise)).items()
        }
        for one in candidates
    ]
    sums: dict[str, float] = {}
    for own in shares:
        for kind, share in own.items():
            sums[kind] = sums.get(kind, 0.0) + share
    kind = max(sums, key=lambda name: sums[name])
    return candidates[max(range(len(shares)), key=lambda n: shares[n].get(kind, 0.0))]
