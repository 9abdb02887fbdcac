"""A press, followed from image to image: the likeliest family alone from where its body was; all
that may still be it when there is more to be told (docs/equations.md, Eq. F19)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.types import Array
from mjtactile.film import FilmState
from mjtactile.sensing.body.area import FACES
from mjtactile.sensing.body.bodies import Hint
from mjtactile.sensing.body.common import Common
from mjtactile.sensing.body.families import FAMILIES, Family, kinds_of, several
from mjtactile.sensing.body.fit import Fit, exactly, refine
from mjtactile.sensing.body.forward import Forward
from mjtactile.sensing.body.motion import Track
from mjtactile.sensing.body.search import Films, approach, beside, search
from mjtactile.sensing.body.standing import Data, Prior, begin, standing
from mjtactile.sensing.settings import BodySettings

_LOST = 1e3  # of the log of evidence: a family of which no body can be there
_FOLLOWED = 3  # rounds of a fit that is followed
_LOOKED = 5  # the same, at a look
_WORSE = 1.5  # times as much is left as when all families were looked for: they are again,
_BAD = 0.5  # of the misfit that is too much: with so much they are looked for at each look
_BETTER = 0.8  # and what explains so much more than what is followed is taken in its place
_STUCK = 1.15  # times the misfit of another family: it is begun with anew
_LEVEL = ("tilt_x", "tilt_y", "lean")
_ONE = tuple(FAMILIES.values())
_PARTS = ("ball", "cylinder", "disc", "block")


@dataclass(frozen=True, eq=False)
class Candidate:
    """A family that may be it: its `fit` at the last look, the `log` of the images' evidence so
    far, and what all looks have told of what it keeps."""

    family: Family
    fit: Fit
    image_log: float
    common: Common

    @property
    def log(self) -> float:
        """Of its evidence: the images', and that it stayed the same."""
        return self.image_log - self.common.drift / 2


@dataclass(frozen=True, eq=False)
class Looked:
    """A body of the newest image, with what was known before: the `image_log` of its family's
    evidence and what its looks had in common; the image's own evidence counts by a `share`."""

    fit: Fit
    image_log: float
    common: Common
    share: float

    def exactly(self, forward: Forward, data: Data, noise: float) -> Looked:
        """With the body's exact slopes."""
        return replace(self, fit=exactly(forward, self.fit, data, noise))

    def with_noise(self, noise: float) -> Candidate:
        """As a candidate, where the markers' variances are `noise` times what is believed."""
        log = self.image_log + self.share * self.fit.log_evidence_with(noise)
        return Candidate(self.fit.family, self.fit, log, self.common.with_look(self.fit))


@dataclass(frozen=True, eq=False)
class Press:
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

    def bodies(self) -> list[tuple[float, Fit]]:
        """Each candidate's probability and body: the newest of the likeliest, of the others that of
        the last look."""
        fits = [self.now, *(one.fit for one in self.candidates[1:])]
        return list(zip(self.probabilities.tolist(), fits, strict=True))


def follow(
    films: Films, press: Press | None, hint: Hint, data: Data, s: BodySettings
) -> Press | None:
    """One image more.

    Args:
        films: The sensor's.
        press: What is known from the images before; None: nothing.
        hint: Where it is touched.
        data: The image.
        s: Settings.

    Returns:
        What is known now; None: no body of any family rests there.
    """
    if press is None:
        return _first(films, hint, data, s)
    told = abs(math.log(data.force / press.force)) > math.log(s.look_force)
    if told or press.images + 1 >= s.look_images:
        looked = _look(films, press, hint, data, s)
    else:
        looked = _follow(films, press, hint, data)
    if looked is None:
        return _first(films, hint, data, s)
    misfit = looked.now.misfit
    worse = misfit > max(_WORSE * press.doubted, s.misfit_asks)
    if worse or (looked.images == 0 and misfit > _BAD * s.misfit_most):
        other = _first(films, hint, data, s, looked.now)
        if other is not None and other.now.misfit < _BETTER * misfit:
            return _with_past(films, press, looked, other, hint, data, s)
        return replace(looked, doubted=misfit)
    return looked


def _first(
    films: Films, hint: Hint, data: Data, s: BodySettings, but: Fit | None = None
) -> Press | None:
    """All families, from nothing, or from the film on a body that is not believed any more; what
    explains no more than that one is given up."""
    if but is None:
        found = search(films, _ONE, hint, data, s.noise_least)
    else:
        found = search(films, _ONE, hint, data, s.noise_least, but.state, but.chi2)
    least = min((one.misfit for one in found), default=math.inf)
    if len(hint.parts) > 1 and least > s.misfit_one:
        balls = several(["ball"] * len(hint.parts))
        both = search(films, (balls,), hint, data, s.noise_least)
        found += both
        if both and s.misfit_one < both[0].misfit < least:
            found += _other_parts(films, both[0], data, s)
    given = [
        Looked(one, -s.log_body * max(len(one.family.parts) - 1, 0), Common.of(one.family), 1.0)
        for one in found
    ]
    looked = _weighed(films, given, hint, data, s)
    return None if looked is None else replace(looked, doubted=looked.now.misfit)


def _with_past(
    films: Films, past: Press, looked: Press, other: Press, hint: Hint, data: Data, s: BodySettings
) -> Press:
    """What was `looked` at and what was found from nothing, `other`, with all that the press has
    told of their families before this image; of one that was not there, that it would have
    explained as much."""
    known = {one.family.name: one for one in (*past.left, *past.candidates)}
    best = past.candidates[0]
    bodies = {one.family.name: one.fit for one in looked.candidates}
    bodies |= {one.family.name: one.fit for one in other.candidates}
    found = []
    for name, fit in bodies.items():
        one = known.get(name)
        if one is None:
            before = best.log - s.log_body * max(len(fit.family.parts) - 1, 0)
            found.append(Looked(fit, before, Common.of(fit.family), s.log_again))
        else:
            found.append(Looked(fit, one.image_log, one.common, s.log_again))
    weighed = _weighed(films, found, hint, data, s, past)
    assert weighed is not None
    return replace(weighed, doubted=weighed.now.misfit)


def _other_parts(films: Films, best: Fit, data: Data, s: BodySettings) -> list[Fit]:
    """One after the other of several bodies is tried as of another family, and stays so where it
    explains more."""
    tried: list[Fit] = []
    noise = max(s.noise_least, best.misfit)
    for place in range(len(best.family.parts)):
        for name in _PARTS:
            names = [part.name for part in best.family.parts]
            if names[place] == name:
                continue
            names[place] = name
            found = _with_part(films, best, several(names), place, data, noise)
            if found is None:
                continue
            tried.append(found)
        likely = max([best, *tried], key=lambda one: one.log_evidence_with(noise))
        best = likely
    return tried


def _with_part(
    films: Films, fit: Fit, family: Family, place: int, data: Data, noise: float
) -> Fit | None:
    """Of several bodies one is of another family: the likeliest of its starts."""
    part = family.parts[place]
    own = fit.hint.parts[place]
    found: list[Fit] = []
    kept = fit.family.split(fit.theta)
    for start in part.starts(own):
        begun = start.copy()
        begun[:3] = kept[place][:3]
        theta = np.concatenate([*kept[:place], begun, *kept[place + 1 :]])
        prior = Prior.of(family, theta)
        at = begin(films.fine, family, fit.hint, theta, data, prior, fit.state)
        if at is None:
            continue
        found.append(
            refine(films.fine, family, fit.hint, at, data, prior, rounds=_LOOKED, noise=noise)
        )
    return min(found, key=lambda one: one.chi2, default=None)


def _look(films: Films, press: Press, hint: Hint, data: Data, s: BodySettings) -> Press | None:
    """All that may still be it, each from where it was."""
    found: list[Looked] = []
    for number, one in enumerate(press.candidates):
        start = press.now if number == 0 else one.fit
        best = min((each.fit for each in found), key=lambda fit: fit.chi2, default=None)
        known = math.inf if best is None else best.chi2
        body = _next(films, one, start, press.noise, hint, data, _LOOKED, known)
        least = press.noise if best is None else best.misfit
        if body is None or body.misfit > _STUCK * least:
            near = (best or press.now).state
            body = _again(films, one, body, press.noise, hint, data, known, near)
        if body is not None:
            found.append(Looked(body, one.image_log, one.common, s.log_again))
    looked = _weighed(films, found, hint, data, s, press)
    return None if looked is None else replace(looked, doubted=press.doubted)


def _weighed(
    films: Films,
    found: list[Looked],
    hint: Hint,
    data: Data,
    s: BodySettings,
    past: Press | None = None,
) -> Press | None:
    """Bodies of an image, weighed; those that are given up, with those that were in the `past`, are
    remembered.

    What even the best leaves of the markers is the film's and the simulator's doing: it is taken
    for noise, the same for all families, so that none wins by chi-squares of hundreds over another
    that is as wrong.
    """
    if not found:
        return None
    noise = max(s.noise_least, min(one.fit.misfit for one in found))
    roughly = [one.with_noise(noise) for one in found]
    least = max(one.log for one in roughly) - s.log_lost
    likely = [one for one, rough in zip(found, roughly, strict=True) if rough.log > least]
    kept = [one.exactly(films.fine, data, noise).with_noise(noise) for one in likely]
    kept.sort(key=lambda one: -one.log)
    spoken = _spoken(kept, noise)
    lost = [rough for rough in roughly if not rough.log > least]
    if past is not None:
        seen = {one.family.name for one in roughly}
        before = (*past.left, *past.candidates)
        lost += [one for one in before if one.family.name not in seen]
    kept.remove(spoken)
    return Press(
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


def _follow(films: Films, press: Press, hint: Hint, data: Data) -> Press | None:
    body = _next(films, press.candidates[0], press.now, press.noise, hint, data, _FOLLOWED)
    if body is None:
        return None
    body = exactly(films.fine, body, data, press.noise, times=0)
    return replace(press, now=body, images=press.images + 1)


def _next(
    films: Films,
    one: Candidate,
    newest: Fit,
    noise: float,
    hint: Hint,
    data: Data,
    rounds: int,
    known: float = math.inf,
) -> Fit | None:
    """A family's body, believed as the looks before have it, from where it was in the newest image
    and as much deeper as the force has grown; given up where it stays far behind `known`, what
    another leaves."""
    family = one.family
    hint = _matched(newest.hint, hint)
    prior = one.common.prior(one.fit, noise, hint)
    stays = family.rebased(newest.theta, newest.hint, hint)
    theta = stays.copy()
    heights = family.heights
    by = -newest.slopes.sums[2, heights].sum() / family.sd[heights[0]]  # N/mm, all of them
    if by < 0:
        theta[heights] += np.clip((data.force - newest.felt) / by, -1.0, 1.0)
    at = begin(films.fine, family, hint, theta, data, prior, newest.state)
    # on flat faces a film now and then goes to and fro from one start, and not from another
    at = at or begin(films.fine, family, hint, stays, data, prior, newest.state)
    at = at or begin(films.fine, family, hint, theta, data, prior, None)
    if at is None:
        return None
    return refine(
        films.fine,
        family,
        hint,
        at,
        data,
        prior,
        slopes=newest.slopes,
        rounds=rounds,
        known=known,
        noise=noise,
    )


def _again(
    films: Films,
    one: Candidate,
    stuck: Fit | None,
    noise: float,
    hint: Hint,
    data: Data,
    known: float,
    near: FilmState,
) -> Fit | None:
    """The same, or what is found anew beside the film `near` it, where that explains more: on flat
    faces fits end before they have come to the end, and what is round has been thought sharp while
    few nodes touched it."""
    if one.family.name in FACES or one.family.parts:
        other = _from_middle(films, one, noise, hint, data, known, near)
    else:
        other = _from_nothing(films, one, noise, hint, data, known, near)
    if other is None or (stuck is not None and stuck.chi2 < other.chi2):
        return stuck
    return other


def _from_nothing(
    films: Films,
    one: Candidate,
    noise: float,
    hint: Hint,
    data: Data,
    known: float,
    near: FilmState,
) -> Fit | None:
    """From all its starts; believed as the looks before have it once it is there."""
    found = search(films, (one.family,), hint, data, noise, near, known)
    if not found:
        return None
    prior = one.common.prior(replace(one.fit, at=found[0].at, hint=hint), noise, hint)
    at = standing(films.fine, one.family, found[0].theta, data, prior, found[0].state)
    return refine(
        films.fine,
        one.family,
        hint,
        at,
        data,
        prior,
        slopes=found[0].slopes,
        rounds=_FOLLOWED,
        known=known,
        noise=noise,
    )


def _from_middle(
    films: Films,
    one: Candidate,
    noise: float,
    hint: Hint,
    data: Data,
    known: float,
    near: FilmState,
) -> Fit | None:
    """From the middle of the touch."""
    family = one.family
    hint = _matched(one.fit.hint, hint)
    prior = one.common.prior(one.fit, noise, hint)
    theta = prior.mean * family.sd
    middle = [n for n, name in enumerate(family.names) if name in ("x", "y", "z", *_LEVEL)]
    theta[middle] = 0.0
    at = beside(films.fine, family, hint, theta, data, prior, near)
    at = at or approach(films.fine, family, hint, theta, data, prior)
    if at is None:
        return None
    return refine(
        films.fine, family, hint, at, data, prior, rounds=_LOOKED, known=known, noise=noise
    )


def _matched(old: Hint, new: Hint) -> Hint:
    """`new` with its parts in the order of those of `old`, which stay where there are not as
    many."""
    if not old.parts:
        return replace(new, parts=())
    if len(new.parts) != len(old.parts):
        return replace(new, parts=old.parts)
    left = list(new.parts)
    parts = []
    for one in old.parts:
        nearest = min(left, key=lambda part: float(np.hypot(*(part.place - one.place))))
        left.remove(nearest)
        parts.append(nearest)
    return replace(new, parts=tuple(parts))
