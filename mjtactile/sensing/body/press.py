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
from mjtactile.sensing.body.families import FAMILIES, Family, kinds_of, several
from mjtactile.sensing.body.fit import Fit, exactly, refine
from mjtactile.sensing.body.forward import Forward
from mjtactile.sensing.body.motion import Track
from mjtactile.sensing.body.search import Films, approach, beside, search
from mjtactile.sensing.body.standing import Data, Prior, begin
from mjtactile.sensing.settings import BodySettings

_LOST = 1e3  # of the log of evidence: a family of which no body can be there
_FOLLOWED = 3  # rounds of a fit that is followed
_LOOKED = 5  # the same, at a look
_WORSE = 1.5  # times as much is left as when all families were looked for: they are again,
_DEEPER = 1.5  # power of the force, with which what the film has wrong grows as a press goes on
_BETTER = 0.8  # and what explains so much more than what is followed is taken in its place
_STUCK = 1.15  # times the misfit of another family: it is begun with anew
_LEVEL = ("tilt_x", "tilt_y", "lean")
_ONE = tuple(FAMILIES.values())
_PARTS = ("ball", "cylinder", "disc", "block")


@dataclass(frozen=True, eq=False)
class Candidate:
    """A family that may be it: its `fit` at the last look, and the `log` of its evidence so far."""

    family: Family
    fit: Fit
    log: float

    def exactly(self, forward: Forward, data: Data, noise: float) -> Candidate:
        """The same with its body's exact slopes, and with what they change of the evidence."""
        fit = exactly(forward, self.fit, data, noise)
        more = fit.log_evidence_with(noise) - self.fit.log_evidence_with(noise)
        return Candidate(self.family, fit, self.log + more)


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
        doubted: Mean square misfit when all families were looked for, or at a look since then: much
            more is too much.
        track: Where the body stood in the last images.
    """

    candidates: tuple[Candidate, ...]
    now: Fit
    noise: float
    force: float
    images: int
    parts: int
    doubted: float
    track: Track = ()

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
        return _first(films, hint, data, s, press.now.state) or _first(films, hint, data, s)
    misfit = looked.now.misfit
    worse = misfit > max(_WORSE * looked.doubted, s.misfit_asks)
    if worse or (looked.images == 0 and misfit > s.misfit_most):
        other = _first(films, hint, data, s, looked.now.state)
        if other is not None and other.now.misfit < _BETTER * misfit:
            return other
        return replace(looked, doubted=misfit)
    usual = min(max(press.doubted, misfit), looked.doubted)
    return replace(looked, doubted=usual)


def _first(
    films: Films, hint: Hint, data: Data, s: BodySettings, near: FilmState | None = None
) -> Press | None:
    """All families, from nothing but the film `near` it, where there is one."""
    found = search(films, _ONE, hint, data, s.noise_least, near)
    least = min((one.misfit for one in found), default=math.inf)
    if len(hint.parts) > 1 and least > s.misfit_one:
        balls = several(["ball"] * len(hint.parts))
        both = search(films, (balls,), hint, data, s.noise_least)
        found += both
        if both and s.misfit_one < both[0].misfit < least:
            found += _other_parts(films, both[0], data, s)
    given = [(one, -s.log_body * max(len(one.family.parts) - 1, 0)) for one in found]
    looked = _weighed(films, given, hint, data, s)
    return None if looked is None else replace(looked, doubted=looked.now.misfit)


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
    found: list[tuple[Fit, float]] = []
    for number, one in enumerate(press.candidates):
        start = press.now if number == 0 else one.fit
        known = min((fit.chi2 for fit, _ in found), default=math.inf)
        body = _next(films, one.fit, start, press.noise, hint, data, _LOOKED, known)
        least = min((fit.misfit for fit, _ in found), default=press.noise)
        flat = one.family.name in FACES or one.family.parts
        if body is None or (flat and body.misfit > _STUCK * least):
            near = min((fit for fit, _ in found), key=lambda fit: fit.chi2, default=press.now)
            body = _again(films, one.fit, body, press.noise, hint, data, known, near.state)
        if body is not None:
            found.append((body, one.log))
    looked = _weighed(films, found, hint, data, s)
    if looked is None:
        return None
    return replace(looked, doubted=press.doubted * max(data.force / press.force, 1.0) ** _DEEPER)


def _weighed(
    films: Films, found: list[tuple[Fit, float]], hint: Hint, data: Data, s: BodySettings
) -> Press | None:
    """Bodies of an image with the logs of their evidence before it.

    What even the best leaves of the markers is the film's and the simulator's doing: it is taken
    for noise, the same for all families, so that none wins by chi-squares of hundreds over another
    that is as wrong.
    """
    if not found:
        return None
    noise = max(s.noise_least, min(fit.misfit for fit, _ in found))
    weighed = [Candidate(fit.family, fit, log + fit.log_evidence_with(noise)) for fit, log in found]
    most = max(one.log for one in weighed)
    likely = [one for one in weighed if one.log > most - s.log_lost]
    kept = [one.exactly(films.fine, data, noise) for one in likely]
    kept.sort(key=lambda one: -one.log)
    spoken = _spoken(kept, noise)
    kept.remove(spoken)
    return Press((spoken, *kept), spoken.fit, noise, data.force, 0, len(hint.parts), 0.0)


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
    looked = press.candidates[0].fit
    body = _next(films, looked, press.now, press.noise, hint, data, _FOLLOWED)
    if body is None:
        return None
    return replace(press, now=exactly(films.fine, body, data, press.noise), images=press.images + 1)


def _next(
    films: Films,
    looked: Fit,
    newest: Fit,
    noise: float,
    hint: Hint,
    data: Data,
    rounds: int,
    known: float = math.inf,
) -> Fit | None:
    """A family's body, believed as at the look before, from where it was in the newest image and
    as much deeper as the force has grown; given up where it stays far behind `known`, what
    another leaves."""
    family = looked.family
    hint = _matched(newest.hint, hint)
    prior = looked.then(noise, hint)
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
    looked: Fit,
    stuck: Fit | None,
    noise: float,
    hint: Hint,
    data: Data,
    known: float,
    near: FilmState,
) -> Fit | None:
    """The same, or what is found from the middle of the touch, beside the film `near` it, where
    that explains more: on flat faces, fits end before they have come to the end."""
    family = looked.family
    hint = _matched(looked.hint, hint)
    prior = looked.then(noise, hint)
    theta = prior.mean * family.sd
    middle = [n for n, name in enumerate(family.names) if name in ("x", "y", "z", *_LEVEL)]
    theta[middle] = 0.0
    at = beside(films.fine, family, hint, theta, data, prior, near)
    at = at or approach(films.fine, family, hint, theta, data, prior)
    if at is None:
        return stuck
    other = refine(
        films.fine, family, hint, at, data, prior, rounds=_LOOKED, known=known, noise=noise
    )
    return other if stuck is None or other.at.cost < stuck.at.cost else stuck


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
