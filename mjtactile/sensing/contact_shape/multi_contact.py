"""Choice of the shape model of each part of a shape with several contacts."""

from __future__ import annotations

import numpy as np

from mjtactile.sensing.contact_shape.fit_state import Data, Prior, begin
from mjtactile.sensing.contact_shape.gauss_newton import Fit, refine
from mjtactile.sensing.contact_shape.initial_search import Films
from mjtactile.sensing.contact_shape.refit import LOOKED
from mjtactile.sensing.contact_shape.shape_models import ShapeModel, several
from mjtactile.sensing.settings import ContactShapeSettings

_PARTS = ("ball", "cylinder", "disc", "block")


def other_parts(films: Films, best: Fit, data: Data, s: ContactShapeSettings) -> list[Fit]:
    """Fit several contacts with each part replaced in turn by another shape model. A replacement is
    kept where it has more evidence. All fits are returned."""
    tried: list[Fit] = []
    noise = max(s.noise_min, best.misfit)
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
    films: Films, fit: Fit, family: ShapeModel, place: int, data: Data, noise: float
) -> Fit | None:
    """Fit several contacts with one part replaced by another model, and return the best start's
    fit."""
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
            refine(films.fine, family, fit.hint, at, data, prior, rounds=LOOKED, noise=noise)
        )
    return min(found, key=lambda one: one.chi2, default=None)
