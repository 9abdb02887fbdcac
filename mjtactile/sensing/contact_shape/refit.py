"""Refit of one shape model to the next image from its last pose, restarted, or with another model
for one of several contacts (docs/theory/contact_shape.md, Eq. F19)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mjtactile.core.types import Array
from mjtactile.quasistatic import MembraneSolution
from mjtactile.sensing.contact_shape.contact_area import FACES
from mjtactile.sensing.contact_shape.fit_state import Data, FitState, Prior, Problem
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.gauss_newton import Fit, damped_step, refine
from mjtactile.sensing.contact_shape.hypotheses import Candidate
from mjtactile.sensing.contact_shape.initial_search import (
    Suggestions,
    approach,
    replace_shape,
    search,
)
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.shape_models import ShapeModel, several
from mjtactile.sensing.settings import ContactShapeSettings

FOLLOWED = 3  # rounds of a fit that is followed
# Thresholds of such a fit: the pose changes little, and the next image continues it
FOLLOWING = {"settled": 0.5, "far": 25.0}
_UNDAMPED = 1e-8
_SAME_FORCE = 1.4  # force ratio up to which the last Jacobian predicts the start of a fit
EVALUATED = 5  # the same, at an evaluation of all candidates
_CENTERED = ("x", "y", "z", "tilt_x", "tilt_y", "lean")  # parameters reset by a restart
_PARTS = ("ball", "cylinder", "disc", "block")


def warm_start(
    forward: ForwardModel,
    candidate: Candidate,
    newest: Fit,
    noise: float,
    hint: InitialGuess,
    data: Data,
    rounds: int,
    known: float = math.inf,
    limits: Mapping[str, float] | None = None,
) -> Fit | None:
    """Refit one shape model to a new image. The prior comes from earlier images. The start is
    predicted from the last pose. The fit stops early when its cost stays
    far above `known`, the cost of a competing model. `limits` are thresholds of `refine`."""
    hint = _matched(newest.hint, hint)
    prior = candidate.common.prior(candidate.fit, noise, hint)
    problem = Problem(forward, candidate.family, hint, data, prior)
    at = _start(problem, newest)
    if at is None:
        return None
    return refine(
        problem, at, slopes=newest.slopes, rounds=rounds, known=known, noise=noise, **(limits or {})
    )


def _start(problem: Problem, newest: Fit) -> FitState | None:
    """Return the start state of a fit, predicted from the fit `newest`; None: the solver did not
    converge."""
    family = problem.family
    same = family.rebased(newest.theta, newest.hint, problem.hint)
    ratio = problem.data.force / newest.force
    if 1 / _SAME_FORCE < ratio < _SAME_FORCE:
        before = problem.state(same, newest.state)
        slopes = newest.slopes.seen(problem.data)
        step = damped_step(slopes, before, family, problem.prior, _UNDAMPED)
        theta = same + step.by * family.sd
    else:
        theta = _deeper(problem, same, newest)
    # on flat faces the solver may oscillate from one start and converge from another
    return (
        problem.fit_state(theta, newest.state)
        or problem.fit_state(same, newest.state)
        or problem.fit_state(theta, None)
    )


def _deeper(problem: Problem, theta: Array, newest: Fit) -> Array:
    """Return the parameters `theta` (k,) shifted in depth by the change of force divided by the
    contact stiffness."""
    family = problem.family
    heights = family.heights
    moved = theta.copy()
    # total contact stiffness, N/mm
    stiffness = -newest.slopes.sums[2, heights].sum() / family.sd[heights[0]]
    if stiffness < 0:
        change = (problem.data.force - newest.force) / stiffness
        moved[heights] += np.clip(change, -1.0, 1.0)
    return moved


def restart_fit(
    forward: ForwardModel,
    candidate: Candidate,
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
    if candidate.family.name in FACES or candidate.family.parts:
        other = _restart_from_centroid(forward, candidate, noise, hint, data, known, near)
    else:
        other = _restart_from_search(forward, candidate, noise, hint, data, known, near)
    if other is None or (stuck is not None and stuck.chi2 < other.chi2):
        return stuck
    return other


def restart_suggested(
    forward: ForwardModel,
    candidate: Candidate,
    stuck: Fit | None,
    noise: float,
    hint: InitialGuess,
    data: Data,
    known: float,
    suggestions: Suggestions,
    near: MembraneSolution,
) -> Fit | None:
    """Return the fit `stuck`, or one from the suggested start of its model if it is better."""
    fit = suggestions.fit(forward, candidate.family, hint, data, noise, near, known)
    if fit is None:
        return stuck
    prior = candidate.common.prior(replace(candidate.fit, at=fit.at, hint=hint), noise, hint)
    problem = Problem(forward, candidate.family, hint, data, prior)
    at = problem.state(fit.theta, fit.state)
    fit = refine(problem, at, slopes=fit.slopes, rounds=FOLLOWED, known=known, noise=noise)
    return stuck if stuck is not None and stuck.chi2 < fit.chi2 else fit


def _restart_from_search(
    forward: ForwardModel,
    candidate: Candidate,
    noise: float,
    hint: InitialGuess,
    data: Data,
    known: float,
    near: MembraneSolution,
) -> Fit | None:
    """Search from all starts, then refine with the prior from earlier evaluations."""
    fits = search(forward, (candidate.family,), hint, data, noise, near, known)
    if not fits:
        return None
    fit = fits[0]
    prior = candidate.common.prior(replace(candidate.fit, at=fit.at, hint=hint), noise, hint)
    problem = Problem(forward, candidate.family, hint, data, prior)
    at = problem.state(fit.theta, fit.state)
    return refine(problem, at, slopes=fit.slopes, rounds=FOLLOWED, known=known, noise=noise)


def _restart_from_centroid(
    forward: ForwardModel,
    candidate: Candidate,
    noise: float,
    hint: InitialGuess,
    data: Data,
    known: float,
    near: MembraneSolution,
) -> Fit | None:
    """Restart a fit from the center of the touch; None: the solver did not converge."""
    family = candidate.family
    hint = _matched(candidate.fit.hint, hint)
    prior = candidate.common.prior(candidate.fit, noise, hint)
    theta = prior.mean * family.sd
    theta[[n for n, name in enumerate(family.names) if name in _CENTERED]] = 0.0
    problem = Problem(forward, family, hint, data, prior)
    at = replace_shape(problem, theta, near) or approach(problem, theta)
    if at is None:
        return None
    return refine(problem, at, rounds=EVALUATED, known=known, noise=noise)


def other_parts(forward: ForwardModel, best: Fit, data: Data, s: ContactShapeSettings) -> list[Fit]:
    """Fit several contacts with each part replaced in turn by another shape model. A replacement is
    kept where it has more evidence. All fits are returned."""
    fits: list[Fit] = []
    noise = max(s.noise_min, best.misfit)
    for part_index in range(len(best.family.parts)):
        names = [part.name for part in best.family.parts]
        for name in _PARTS:
            if names[part_index] != name:
                family = several([*names[:part_index], name, *names[part_index + 1 :]])
                fits += _with_part(forward, best, family, part_index, data, noise)
        best = max([best, *fits], key=lambda fit: fit.log_evidence_with(noise))
    return fits


def _with_part(
    forward: ForwardModel, fit: Fit, family: ShapeModel, part_index: int, data: Data, noise: float
) -> list[Fit]:
    """Fit several contacts with one part replaced by another model, and return the best start's
    fit; empty: the solver did not converge."""
    fits: list[Fit] = []
    kept = fit.family.split(fit.theta)
    for start in family.parts[part_index].starts(fit.hint.parts[part_index]):
        part = np.concatenate([kept[part_index][:3], start[3:]])
        theta = np.concatenate([*kept[:part_index], part, *kept[part_index + 1 :]])
        problem = Problem(forward, family, fit.hint, data, Prior.of(family, theta))
        at = problem.fit_state(theta, fit.state)
        if at is not None:
            fits.append(refine(problem, at, rounds=EVALUATED, noise=noise))
    return sorted(fits, key=lambda fit: fit.chi2)[:1]


def _matched(old: InitialGuess, new: InitialGuess) -> InitialGuess:
    """Return `new` with its parts in the order of `old`, or with the parts of `old` if their
    counts differ."""
    if not old.parts:
        return replace(new, parts=())
    if len(new.parts) != len(old.parts):
        return replace(new, parts=old.parts)
    left = list(new.parts)
    parts = []
    for one in old.parts:
        nearest = min(left, key=lambda part: float(np.hypot(*(part.position - one.position))))
        left.remove(nearest)
        parts.append(nearest)
    return replace(new, parts=tuple(parts))
