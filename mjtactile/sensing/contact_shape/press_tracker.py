"""Tracking of the contact shape from image to image.

Usually only the most likely model is refitted, from its last pose. All remaining candidates are
evaluated when an image has new information (docs/theory/contact_shape.md, Eq. F19).
"""

from __future__ import annotations

import math
from dataclasses import replace

from mjtactile.sensing.contact_shape.fit_state import Data
from mjtactile.sensing.contact_shape.gauss_newton import exactly
from mjtactile.sensing.contact_shape.hypotheses import Evaluation, PressHistory, weighed
from mjtactile.sensing.contact_shape.initial_search import Films, search
from mjtactile.sensing.contact_shape.multi_contact import other_parts
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.refit import FOLLOWED, LOOKED, restart_fit, warm_start
from mjtactile.sensing.contact_shape.shape_filter import ShapeFilter
from mjtactile.sensing.contact_shape.shape_models import FAMILIES, several
from mjtactile.sensing.settings import ContactShapeSettings

_WORSE = 1.5  # misfit ratio to the last search over all models above which they are searched again
_BAD = 0.25  # fraction of misfit_max above which every evaluation with grown force searches all
_BETTER = 0.8  # misfit ratio below which a newly fitted shape replaces the tracked one
_STUCK = 1.15  # misfit ratio to the best model above which a fit is restarted
_ONE = tuple(FAMILIES.values())


def follow(
    films: Films,
    press: PressHistory | None,
    hint: InitialGuess,
    data: Data,
    s: ContactShapeSettings,
) -> PressHistory | None:
    """Update the shape history with the next image; None: no model converged."""
    if press is None:
        return _first(films, hint, data, s)
    grown = data.force > s.check_force * press.force
    told = grown or data.force < press.force / s.check_force
    looked = None
    if not told and press.images + 1 < s.check_images:
        looked = _follow(films, press, hint, data)
    # the tracked fit may be stuck
    if looked is None or _is_worse(looked, press, s):
        looked = _look(films, press, hint, data, s)
    if looked is None:
        return _first(films, hint, data, s)
    worse = _is_worse(looked, press, s)
    # A dragged shape fits worse but is still the same. Only a deeper indentation can show another.
    if grown and (worse or looked.now.misfit > _BAD * s.misfit_max):
        other = _first(films, hint, data, s, looked)
        if other is not None and other.now.misfit < _BETTER * looked.now.misfit:
            return _with_past(films, press, looked, other, hint, data, s)
        worse = True
    return replace(looked, doubted=looked.now.misfit) if worse else looked


def _is_worse(looked: PressHistory, press: PressHistory, s: ContactShapeSettings) -> bool:
    """Return True if the fit is worse than at the last search over all models."""
    return looked.now.misfit > max(_WORSE * press.doubted, s.misfit_asks)


def _first(
    films: Films,
    hint: InitialGuess,
    data: Data,
    s: ContactShapeSettings,
    but: PressHistory | None = None,
) -> PressHistory | None:
    """Fit all models without a prior, or from the membrane solution on the rejected shape `but`.
    With `but`, models far behind in this contact episode are skipped. Fits that explain no more
    than `but` are stopped."""
    if but is None:
        found = search(films, _ONE, hint, data, s.noise_min)
    else:
        now = but.now
        found = search(films, but.near(_ONE), hint, data, s.noise_min, now.state, now.chi2)
    minimum = min((one.misfit for one in found), default=math.inf)
    if len(hint.parts) > 1 and minimum > s.misfit_one:
        balls = several(["ball"] * len(hint.parts))
        both = search(films, (balls,), hint, data, s.noise_min)
        found += both
        if both and s.misfit_one < both[0].misfit < minimum:
            found += other_parts(films, both[0], data, s)
    given = [
        Evaluation(
            one, -s.log_body * max(len(one.family.parts) - 1, 0), ShapeFilter.of(one.family), 1.0
        )
        for one in found
    ]
    looked = weighed(films, given, hint, data, s)
    return None if looked is None else replace(looked, doubted=looked.now.misfit)


def _with_past(
    films: Films,
    past: PressHistory,
    looked: PressHistory,
    other: PressHistory,
    hint: InitialGuess,
    data: Data,
    s: ContactShapeSettings,
) -> PressHistory:
    """Merge the evaluation `looked` and the new search `other`, with the history of their models.
    The history is that before this image. A model without history is assumed to have explained the
    images equally well."""
    known = {one.family.name: one for one in (*past.left, *past.candidates)}
    best = past.candidates[0]
    bodies = {one.family.name: one.fit for one in looked.candidates}
    bodies |= {one.family.name: one.fit for one in other.candidates}
    found = []
    for name, fit in bodies.items():
        one = known.get(name)
        if one is None:
            before = best.log - s.log_body * max(len(fit.family.parts) - 1, 0)
            found.append(Evaluation(fit, before, ShapeFilter.of(fit.family), s.log_again))
        else:
            found.append(Evaluation(fit, one.image_log, one.common, s.log_again))
    both = weighed(films, found, hint, data, s, past)
    assert both is not None
    return replace(both, doubted=both.now.misfit)


def _look(
    films: Films, press: PressHistory, hint: InitialGuess, data: Data, s: ContactShapeSettings
) -> PressHistory | None:
    """All that may still be it, each from where it was."""
    found: list[Evaluation] = []
    for number, one in enumerate(press.candidates):
        start = press.now if number == 0 else one.fit
        best = min((each.fit for each in found), key=lambda fit: fit.chi2, default=None)
        known = math.inf if best is None else best.chi2
        body = warm_start(films, one, start, press.noise, hint, data, LOOKED, known)
        minimum = press.noise if best is None else best.misfit
        if body is None or body.misfit > _STUCK * minimum:
            near = (best or press.now).state
            body = restart_fit(films, one, body, press.noise, hint, data, known, near)
        if body is not None:
            found.append(Evaluation(body, one.image_log, one.common, s.log_again))
    looked = weighed(films, found, hint, data, s, press)
    return None if looked is None else replace(looked, doubted=press.doubted)


def _follow(
    films: Films, press: PressHistory, hint: InitialGuess, data: Data
) -> PressHistory | None:
    body = warm_start(films, press.candidates[0], press.now, press.noise, hint, data, FOLLOWED)
    if body is None:
        return None
    body = exactly(films.fine, body, data, press.noise, times=0)
    return replace(press, now=body, images=press.images + 1)
