"""Where a family's fit begins, when nothing is known yet: from its starts, on a coarse film
first."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Array
from mjtactile.film import FilmState
from mjtactile.sensing.body.bodies import Hint
from mjtactile.sensing.body.families import Family
from mjtactile.sensing.body.fit import At, Data, Fit, Prior, begin, refine
from mjtactile.sensing.body.forward import Forward, converged

_APPROACH = (1.2, 0.7, 0.3, 0.0)  # mm above the start: the film is pressed in steps
_FORCE_STEPS = 3
_FORCE_NEAR = 0.1  # of the force that is felt
_STIFFNESS = (0.05, 0.12, 2.0)  # N/mm of a touch: least, first, most
_HOPELESS = 120.0  # of the sum of squares over the noise: a family so far behind is not looked for
_COARSE_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class Films:
    """Two films of one sensor, `fine`, and `coarse` for what is looked for first, and by how much
    markers' heights (N,) m go up with a share of gas."""

    fine: Forward
    coarse: Forward
    by_gas: Array


def search(
    films: Films, families: Sequence[Family], hint: Hint, data: Data, noise: float
) -> list[Fit]:
    """Each family's body, of which nothing is known yet.

    Args:
        films: The sensor's.
        families: Of which.
        hint: Where it was touched.
        data: The image.
        noise: Of the markers' variances, what even the best leaves.

    Returns:
        The bodies, without those of families that explain far less than others, or in which no
        film rests.
    """
    there = hint.on(films.coarse.nodes, hint.rounding * films.coarse.spacing / films.fine.spacing)
    coarse = data.raised(films.coarse.rest_heights - films.fine.rest_heights)
    rough = [_roughly(films.coarse, family, there, coarse) for family in families]
    costs = [math.inf if one is None else one.chi2 for one in rough]
    least = min(costs)
    if math.isinf(least):
        return []
    noise = max(noise, least / len(data.heights))
    order = np.argsort(costs)
    found: list[Fit] = []
    known = math.inf
    for k in order:
        one = rough[k]
        if one is None or costs[k] > least + _HOPELESS * noise:
            continue
        prior = Prior.of(families[k], one.theta)
        at = approach(films.fine, families[k], hint, one.theta, data, prior)
        if at is None:
            continue
        body = refine(films.fine, families[k], hint, at, data, prior, known=known)
        if body is not None:
            found.append(body)
            known = min(known, body.chi2)
    return found


def _roughly(forward: Forward, family: Family, hint: Hint, data: Data) -> Fit | None:
    """From the start that explains most after the body is pressed in as far as it feels the
    force."""
    reached = []
    for start in family.starts(hint):
        prior = Prior.of(family, start)
        at = approach(forward, family, hint, start, data, prior)
        if at is not None:
            reached.append((at, prior))
    if not reached:
        return None
    best, prior = min(reached, key=lambda one: one[0].cost)
    return refine(forward, family, hint, best, data, prior, rounds=_COARSE_ROUNDS)


def approach(
    forward: Forward, family: Family, hint: Hint, start: Array, data: Data, prior: Prior
) -> At | None:
    """Press a body in until it feels the force that was felt.

    Args:
        forward: The film.
        family: The family.
        hint: What its numbers count from.
        start: Its numbers, in about the height where it begins to touch.
        data: The image.
        prior: What is believed.

    Returns:
        Where a fit may begin; None: no film rests there.
    """
    theta = np.clip(start, family.low, family.high)
    heights = family.heights
    state = None
    force = 0.0
    reached = theta
    for above in _APPROACH:
        trial = theta.copy()
        trial[heights] += above
        batch = forward.solve([family.build(trial, hint)], state)
        if not converged(batch):
            break
        state = batch[0]
        reached = trial
        force = state.force_normal
        if force > data.force:
            break
    if state is None:
        return None
    return _to_force(forward, family, hint, (reached, state, force), data, prior)


def _to_force(
    forward: Forward,
    family: Family,
    hint: Hint,
    reached: tuple[Array, FilmState, float],
    data: Data,
    prior: Prior,
) -> At | None:
    theta, state, force = reached
    heights = family.heights
    stiffness = _STIFFNESS[1] * len(heights)
    for _ in range(_FORCE_STEPS):
        if abs(force - data.force) < _FORCE_NEAR * data.force:
            break
        down = float(np.clip((data.force - force) / stiffness, -0.5, 0.5))
        trial = theta.copy()
        trial[heights] -= down
        trial = np.clip(trial, family.low, family.high)
        batch = forward.solve([family.build(trial, hint)], state)
        if not converged(batch):
            break
        theta = trial
        state = batch[0]
        before = force
        force = state.force_normal
        if abs(down) > 1e-6:
            stiffness = float(np.clip((force - before) / down, _STIFFNESS[0], _STIFFNESS[2]))
    return begin(forward, family, hint, theta, data, prior, state)
