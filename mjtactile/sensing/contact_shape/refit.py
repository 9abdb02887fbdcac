"""Refit of one shape model to the next image: from its last pose, or restarted.

See docs/theory/contact_shape.md, Eq. F19.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mjtactile.quasistatic import MembraneSolution
from mjtactile.sensing.contact_shape.contact_area import FACES
from mjtactile.sensing.contact_shape.fit_state import Data, begin, standing
from mjtactile.sensing.contact_shape.gauss_newton import Fit, refine
from mjtactile.sensing.contact_shape.hypotheses import Candidate
from mjtactile.sensing.contact_shape.initial_search import Films, approach, beside, search
from mjtactile.sensing.contact_shape.primitives import InitialGuess

FOLLOWED = 3  # rounds of a fit that is followed
LOOKED = 5  # the same, at an evaluation of all candidates
_LEVEL = ("tilt_x", "tilt_y", "lean")


def warm_start(
    films: Films,
    one: Candidate,
    newest: Fit,
    noise: float,
    hint: InitialGuess,
    data: Data,
    rounds: int,
    known: float = math.inf,
) -> Fit | None:
    """Refit one shape model to a new image. The prior comes from earlier images. The start is the
    last pose, shifted in depth by the force change divided by the contact stiffness. The fit stops
    early when its cost stays far above `known`, the cost of a competing model."""
    family = one.family
    hint = _matched(newest.hint, hint)
    prior = one.common.prior(one.fit, noise, hint)
    stays = family.rebased(newest.theta, newest.hint, hint)
    theta = stays.copy()
    heights = family.heights
    # total contact stiffness, N/mm
    by = -newest.slopes.sums[2, heights].sum() / family.sd[heights[0]]
    if by < 0:
        theta[heights] += np.clip((data.force - newest.felt) / by, -1.0, 1.0)
    at = begin(films.fine, family, hint, theta, data, prior, newest.state)
    # on flat faces the solver may oscillate from one start and converge from another
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


def restart_fit(
    films: Films,
    one: Candidate,
    stuck: Fit | None,
    noise: float,
    hint: InitialGuess,
    data: Data,
    known: float,
    near: MembraneSolution,
) -> Fit | None:
    """Return the fit `stuck`, or a restarted fit next to the membrane solution `near` if it is
    better. Fits on flat faces can stop early. A round shape can look sharp while few nodes touch
    it."""
    if one.family.name in FACES or one.family.parts:
        other = _restart_from_centroid(films, one, noise, hint, data, known, near)
    else:
        other = _from_nothing(films, one, noise, hint, data, known, near)
    if other is None or (stuck is not None and stuck.chi2 < other.chi2):
        return stuck
    return other


def _from_nothing(
    films: Films,
    one: Candidate,
    noise: float,
    hint: InitialGuess,
    data: Data,
    known: float,
    near: MembraneSolution,
) -> Fit | None:
    """Search from all starts, then refine with the prior from earlier evaluations."""
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
        rounds=FOLLOWED,
        known=known,
        noise=noise,
    )


def _restart_from_centroid(
    films: Films,
    one: Candidate,
    noise: float,
    hint: InitialGuess,
    data: Data,
    known: float,
    near: MembraneSolution,
) -> Fit | None:
    """Restart a fit from the center of the touch, and return it; None: the solver did not
    converge."""
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
        films.fine, family, hint, at, data, prior, rounds=LOOKED, known=known, noise=noise
    )


def _matched(old: InitialGuess, new: InitialGuess) -> InitialGuess:
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
