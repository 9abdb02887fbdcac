"""Shape models of an explored object: round, round with a flat end, cylinder, cone, box, or free.

All are the superquadric of `mjtactile.explore.superquadric`. A model defines the free parameters
among the fourteen, and the amplitude of the additional field. The evidence selects the model
(docs/theory/exploration.md, Eq. E5). At equal fit it favors few parameters, because they make
sharper predictions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Array
from mjtactile.explore.superquadric import UNCUT

HALF = 15.0
"""Prior half size of a graspable object, mm."""
_PLACE_SD = 15.0  # mm
_SIZE_SD = 0.6  # sd of the logarithm of all sizes together
_ASPECT_SD = 0.4  # sd of the logarithm of each size
_ROTATION_SD = 2.0  # rad
_TIED = 0.01  # standard deviation of parameters fixed by a model: exponents, tapers, equal sizes
_ALIKE = 3e-3  # sd of the logarithm of sizes that are equal in a shape model
_SMALL_FIELDS = ((0.0, 10.0), (0.05, 8.0), (0.15, 8.0))
"""Standard deviation and correlation length, mm, of the residual field of a simple shape.

The most likely pair is selected.
"""
_FIELDS = (*_SMALL_FIELDS, (0.5, 8.0), (1.2, 8.0), (0.5, 14.0), (1.5, 14.0))


@dataclass(frozen=True, eq=False)
class ObjectFamily:
    """Shape model: a distribution of similar shapes.

    Attributes:
        name: Name of the shape model.
        mean: (14,) Prior mean of the parameters.
        cov: (14, 14) Prior covariance.
        root: (14, 14) Whitening matrix for a deviation from the mean.
        starts: Start values of the exponents.
        cut: True if one of its ends may be flat.
        fields: Candidate standard deviations and correlation lengths of the additional field,
            mm.
    """

    name: str
    mean: Array
    cov: Array
    root: Array
    starts: tuple[tuple[float, float], ...]
    fields: tuple[tuple[float, float], ...]
    cut: bool = False


def _family(
    name: str,
    along: tuple[float, float],
    across: tuple[float, float],
    *,
    taper: float = _TIED,
    equal_tapers: bool = True,
    round_across: bool = False,
    cut: bool = False,
    starts: tuple[tuple[float, float], ...] = (),
    fields: tuple[tuple[float, float], ...] = _SMALL_FIELDS,
) -> ObjectFamily:
    """Return a model with exponents `along` and `across` as mean and sd, and the taper's sd."""
    end, end_sd = _CUT if cut else (UNCUT, _TIED)
    mean = np.array([0.0] * 6 + [np.log(HALF)] * 3 + [along[0], across[0]] + [0.0] * 2 + [end])
    pose = [_PLACE_SD**2] * 3 + [_ROTATION_SD**2] * 3
    shape = [along[1] ** 2, across[1] ** 2, taper**2, taper**2, end_sd**2]
    cov = np.diag([*pose, 0.0, 0.0, 0.0, *shape])
    cov[6:9, 6:9] = _SIZE_SD**2 + _ASPECT_SD**2 * np.eye(3)
    if round_across:
        cov[6:8, 6:8] = _SIZE_SD**2 + _ASPECT_SD**2 + _ALIKE**2 * np.eye(2)
    if equal_tapers:
        cov[11:13, 11:13] = taper**2 + _TIED**2 * np.eye(2)
    root = np.linalg.inv(np.linalg.cholesky(cov))
    return ObjectFamily(name, mean, cov, root, starts or ((along[0], across[0]),), fields, cut)


_CUT = (0.8, 0.2)  # position of a flat end, as a fraction of the lower half; sd
_FULL = (1.0, 0.2)
_SHARP = (0.1, 0.06)
_ROUND = (1.0, _TIED)
FREE = _family(
    "free",
    (0.8, 0.5),
    (0.8, 0.5),
    taper=0.15,
    equal_tapers=False,
    starts=((1.0, 1.0), (0.25, 1.0), (0.25, 0.25)),
    fields=_FIELDS,
)
FAMILIES = (
    _family("ellipsoid", _ROUND, _ROUND),
    _family("dome", _FULL, _ROUND, taper=0.15, round_across=True, cut=True, fields=_FIELDS),
    _family("cylinder", _SHARP, _ROUND, round_across=True),
    _family("cone", _SHARP, _ROUND, taper=0.15, round_across=True),
    _family("box", _SHARP, _SHARP),
    FREE,
)
"""Shape models, ordered by their number of parameters, fewest first."""
