"""Tracking of the contact shape from image to image.

Usually only the most likely model is refitted, from its last pose. All remaining candidates are
evaluated when an image has new information (docs/theory/contact_shape.md, Eq. F19).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from mjtactile.sensing.contact_shape.fit_state import Data
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.gauss_newton import Fit, exactly
from mjtactile.sensing.contact_shape.hypotheses import Candidate, Evaluation, PressHistory, weigh
from mjtactile.sensing.contact_shape.initial_search import Suggestions, search, suggested
from mjtactile.sensing.contact_shape.linear_update import Linearization
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.refit import (
    EVALUATED,
    FOLLOWED,
    FOLLOWING,
    other_parts,
    restart_fit,
    restart_suggested,
    warm_start,
)
from mjtactile.sensing.contact_shape.shape_filter import ShapeFilter
from mjtactile.sensing.contact_shape.shape_models import FAMILIES, several
from mjtactile.sensing.settings import ContactShapeSettings

_WORSE = 1.5  # misfit ratio to the last search over all models above which they are searched again
_BAD = 0.25  # fraction of misfit_max above which every evaluation with grown force searches all
_BETTER = 0.8  # misfit ratio below which a newly fitted shape replaces the tracked one
_STUCK = 1.15  # misfit ratio to the best model above which a fit is restarted
Suggest = Callable[[Data], Suggestions]
_SUGGESTED = 3  # models fitted in the first image of a contact episode
_SUGGESTED_AGAIN = 2  # models that the candidates of an evaluation must include
_UNLIKELY = 3.0  # log evidence behind the best: 5 %
_LIKELY_START = 0.1  # probability of a model whose fit is restarted from the suggested start
_LIKELY_AGAIN = 0.4  # probability of a suggested model that was dropped, to try it again
_CERTAIN = 0.99  # probability of several contacts, or of one, by the network
_SINGLE = tuple(FAMILIES.values())


def follow(
    forward: ForwardModel,
    press: PressHistory | None,
    hint: InitialGuess,
    data: Data,
    s: ContactShapeSettings,
    suggest: Suggest | None = None,
) -> PressHistory | None:
    """Update the shape history with the next image; None: no model converged. `suggest` returns the
    starts of the models. None: they are searched."""
    if press is None:
        return _search_all(forward, hint, data, s, None, suggest)
    grown = data.force > s.check_force * press.force
    changed = grown or data.force < press.force / s.check_force
    new = None
    held = press.reported is not None and press.reported.holds(data.force, hint.position)
    if not changed and (held or press.images + 1 < s.check_images):
        new = _refit_best(forward, press, hint, data)
    # the tracked fit may be stuck
    if new is None or _is_worse(new, press, s):
        fraction = s.log_again if press.adds_evidence(data.force) or new is not None else 0.0
        press = press if new is None else replace(press, now=new.now, linear=new.linear)
        new = _evaluate_candidates(forward, press, hint, data, s, fraction, suggest, grown)
    if new is None:
        return _search_all(forward, hint, data, s, None, suggest)
    worse = _is_worse(new, press, s)
    # A dragged shape fits worse but is still the same. Only a deeper indentation can show another.
    explained = min(candidate.fit.misfit for candidate in new.candidates)
    deeper = data.force > s.check_force * press.search_force
    if deeper and explained > min(_bad_misfit(press, s), _BAD * s.misfit_max):
        other = _search_all(forward, hint, data, s, new, suggest)
        if other is not None and other.now.misfit < _BETTER * new.now.misfit:
            return _with_past(forward, press, new, other, hint, data, s)
        new = replace(new, search_force=data.force)
        worse = True
    return replace(new, search_misfit=new.now.misfit) if worse else new


def _is_worse(new: PressHistory, press: PressHistory, s: ContactShapeSettings) -> bool:
    """Return True if the fit is worse than at the last search over all models."""
    return new.now.misfit > _bad_misfit(press, s)


def _bad_misfit(press: PressHistory, s: ContactShapeSettings) -> float:
    return max(_WORSE * press.search_misfit, s.misfit_asks)


def _search_all(
    forward: ForwardModel,
    hint: InitialGuess,
    data: Data,
    s: ContactShapeSettings,
    rejected: PressHistory | None = None,
    suggest: Suggest | None = None,
) -> PressHistory | None:
    """Fit all models without a prior. The suggested ones are enough if one explains the markers.

    With a `rejected` shape, the fits start from its membrane solution, and its candidates are not
    fitted again. Models far behind are skipped. Fits that explain no more than the rejected one are
    stopped.
    """
    suggestions = None if suggest is None else suggest(data)
    together = None if suggestions is None else suggestions.several
    fits: list[Fit] = []
    if together is not None and together > _CERTAIN:
        fits = _several_fits(forward, hint, data, s, rejected, math.inf)
    if not any(fit.misfit < s.misfit_asks for fit in fits):
        fits += _single_fits(forward, hint, data, s, rejected, suggestions)
        minimum = min((fit.misfit for fit in fits), default=math.inf)
        possible = together is None or 1 - _CERTAIN < together <= _CERTAIN
        if possible or s.misfit_max < minimum < math.inf:
            fits += _several_fits(forward, hint, data, s, rejected, minimum)
    if rejected is not None:
        minimum = min((fit.misfit for fit in fits), default=math.inf)
        if minimum > rejected.now.misfit:
            return None
    new = [
        Evaluation(fit, -_penalty(fit, s), ShapeFilter.of(fit.family, s.mesh_ratio), 1.0)
        for fit in fits
    ]
    return weigh(forward, new, hint, data, s)


def _single_fits(
    forward: ForwardModel,
    hint: InitialGuess,
    data: Data,
    s: ContactShapeSettings,
    rejected: PressHistory | None,
    suggestions: Suggestions | None,
) -> list[Fit]:
    """Fit the suggested models of one contact, or all if none of these explains the markers. With a
    `rejected` shape, those that it has not excluded."""
    if rejected is None:
        if suggestions is None:
            return search(forward, _SINGLE, hint, data, s.noise_min)
        fits = suggested(forward, suggestions, hint, data, s.noise_min, _SUGGESTED)
        minimum = min((fit.misfit for fit in fits), default=math.inf)
        known = minimum < s.misfit_asks or len(hint.parts) > 1
        return fits if fits and known else search(forward, _SINGLE, hint, data, s.noise_min)
    now = rejected.now
    fitted = {candidate.family.name for candidate in rejected.candidates}
    near = [family for family in rejected.near(_SINGLE) if family.name not in fitted]
    if suggestions is not None:
        behind = rejected.behind
        likely = suggestions.likely({name: behind.get(name, 0.0) for name in FAMILIES})
        near = [family for family in near if family.name in likely]
    return search(forward, near, hint, data, s.noise_min, now.state, now.chi2)


def _several_fits(
    forward: ForwardModel,
    hint: InitialGuess,
    data: Data,
    s: ContactShapeSettings,
    rejected: PressHistory | None,
    minimum: float,
) -> list[Fit]:
    """Fit balls to several contacts, and other shapes if these do not explain the markers. Empty:
    one shape explains them, with the misfit `minimum`."""
    if rejected is not None:
        minimum = min(minimum, rejected.now.misfit)
    if len(hint.parts) < 2 or minimum <= s.misfit_one:
        return []
    balls = several(["ball"] * len(hint.parts))
    known = math.inf if rejected is None else rejected.now.chi2
    both = search(forward, (balls,), hint, data, s.noise_min, known=known)
    if both and s.misfit_one < both[0].misfit < minimum:
        both += other_parts(forward, both[0], data, s)
    return both


def _penalty(fit: Fit, s: ContactShapeSettings) -> float:
    """Return the log evidence that additional parts must gain."""
    return s.log_shape * max(len(fit.family.parts) - 1, 0)


def _with_past(
    forward: ForwardModel,
    past: PressHistory,
    new: PressHistory,
    other: PressHistory,
    hint: InitialGuess,
    data: Data,
    s: ContactShapeSettings,
) -> PressHistory | None:
    """Merge the evaluation `new` and the search `other`, with the history of their models before
    this image. A model without history is assumed to have explained the images equally well."""
    known = {candidate.family.name: candidate for candidate in (*past.dropped, *past.candidates)}
    best = past.candidates[0]
    fits = {
        candidate.family.name: candidate.fit for candidate in (*new.candidates, *other.candidates)
    }
    merged = []
    for name, fit in fits.items():
        if name in known:
            log, common = known[name].image_log, known[name].common
        else:
            log, common = best.log - _penalty(fit, s), ShapeFilter.of(fit.family, s.mesh_ratio)
        merged.append(Evaluation(fit, log, common, s.log_again))
    return weigh(forward, merged, hint, data, s, past)


def _evaluate_candidates(
    forward: ForwardModel,
    press: PressHistory,
    hint: InitialGuess,
    data: Data,
    s: ContactShapeSettings,
    share: float,
    suggest: Suggest | None,
    grown: bool,
) -> PressHistory | None:
    """Refit all candidates, each from its last fit. Their evidence is weighted by `share`, zero in
    a hold. If the force has grown, a suggested model that is not among them is added."""
    found: list[Evaluation] = []
    suggestions = None if suggest is None else suggest(data)
    possible = _possible(press, suggestions, share, s)
    for candidate in possible:
        start = press.solved if candidate is press.candidates[0] else candidate.fit
        best = min((each.fit for each in found), key=lambda fit: fit.chi2, default=None)
        known = math.inf if best is None else best.chi2
        fit = warm_start(forward, candidate, start, press.noise, hint, data, EVALUATED, known)
        minimum = press.noise if best is None else best.misfit
        if fit is None or fit.misfit > _STUCK * minimum:
            near = (best or press.solved).state
            known = known if fit is None else min(known, fit.chi2)
            if suggestions is None or candidate.family.parts:
                fit = restart_fit(forward, candidate, fit, press.noise, hint, data, known, near)
            elif fit is None or suggestions.probability(candidate.family.name) > _LIKELY_START:
                fit = restart_suggested(
                    forward, candidate, fit, press.noise, hint, data, known, suggestions, near
                )
        if fit is not None:
            found.append(Evaluation(fit, candidate.image_log, candidate.common, share))
    if grown and suggestions is not None and found:
        found += _added(forward, press, found, suggestions, hint, data, s)
    new = weigh(forward, found, hint, data, s, press)
    if new is None:
        return None
    return replace(new, search_misfit=press.search_misfit, search_force=press.search_force)


def _possible(
    press: PressHistory, suggestions: Suggestions | None, share: float, s: ContactShapeSettings
) -> list[Candidate]:
    """Return the candidates that are likely by earlier images and this one. A dropped model is
    among them again if those that remained have explained the images worse since then. An image
    without evidence excludes no model, so those with a small probability are not fitted."""
    best = max(candidate.log for candidate in press.candidates)
    if not share:
        rest = press.candidates[1:]
        return [
            press.candidates[0],
            *(candidate for candidate in rest if candidate.log > best - _UNLIKELY),
        ]
    again = [
        candidate
        for candidate in press.dropped
        if candidate.log + candidate.possible > best - s.log_lost
    ]
    every = [*press.candidates, *again]
    if suggestions is None:
        return every
    logs = {
        candidate.family.name: candidate.log - best
        for candidate in every
        if not candidate.family.parts
    }
    likely = suggestions.likely(logs)
    known = [candidate for candidate in every if candidate.family.name in likely]
    known.sort(key=lambda candidate: -likely[candidate.family.name])
    return [*(candidate for candidate in every if candidate.family.parts), *known] or every[:1]


def _added(
    forward: ForwardModel,
    press: PressHistory,
    found: list[Evaluation],
    suggestions: Suggestions,
    hint: InitialGuess,
    data: Data,
    s: ContactShapeSettings,
) -> list[Evaluation]:
    """Fit the suggested models that are not candidates. A model without history gets that of the
    best one."""
    past = {candidate.family.name: candidate for candidate in press.dropped}
    tried = {candidate.family.name for candidate in press.candidates} | {
        candidate.fit.family.name for candidate in found
    }
    best = min((each.fit for each in found), key=lambda fit: fit.chi2)
    added = []
    likely = suggestions.likely(dict.fromkeys(FAMILIES, 0.0))
    for name in suggestions.names(_SUGGESTED_AGAIN):
        if (
            name not in likely
            or name in tried
            or (name in past and suggestions.probability(name) < _LIKELY_AGAIN)
        ):
            continue
        family = FAMILIES[name]
        fit = suggestions.fit(forward, family, hint, data, press.noise, best.state, best.chi2)
        if fit is None:
            continue
        log, common = press.candidates[0].log, ShapeFilter.of(family, s.mesh_ratio)
        if name in past:
            log, common = past[name].image_log, past[name].common
        added.append(Evaluation(fit, log, common, s.log_again))
    return added


def _refit_best(
    forward: ForwardModel, press: PressHistory, hint: InitialGuess, data: Data
) -> PressHistory | None:
    """Refit the most likely model: by the linear model if it holds, else with new membrane
    solutions. None: the solver did not converge."""
    images = press.images + 1
    best = press.candidates[0]
    linear = press.linear or _linearization(press, best)
    now = None
    if len(linear.fit.hint.parts) in (0, len(hint.parts)):
        now = linear.update(data, press.noise)
    if now is not None:
        return replace(press, now=now, linear=linear, images=images)
    fit = warm_start(
        forward, best, press.solved, press.noise, hint, data, FOLLOWED, limits=FOLLOWING
    )
    if fit is None:
        return None
    fit = exactly(forward, fit, data, press.noise, times=0)
    return replace(press, now=fit, linear=None, images=images)


def _linearization(press: PressHistory, best: Candidate) -> Linearization:
    """Return the linear model at the newest fit."""
    fit = press.now
    return Linearization(fit, best.common.prior(best.fit, press.noise, fit.hint))
