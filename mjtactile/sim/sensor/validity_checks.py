"""Limits of the method: InputErrors at scene construction, flags and stops at run time.

A flag marks results of reduced accuracy, with the reason and the nearest setting that works. An
InputError or a stop (SimulationError) prevents wrong results.
"""

from __future__ import annotations

import numpy as np

from mjtactile.core import analytical_solutions
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.flags import Reasons
from mjtactile.core.neo_hookean import Law, principal_stresses
from mjtactile.core.types import Array

STVK_ERROR = 0.02  # maximum relative error of a height
# maximum stretch relative to the free membrane; beyond it, real rubber (Treloar 1944) is more than
# about 10 % off the neo-Hookean law
STRETCHED = 1.4
WRINKLED = 0.01  # fraction of the membrane under compression
SLACKEST = 0.95
_BENDING = 0.05  # maximum ratio of bending stiffness to the bulge's stiffness
_THICKEST = 0.1  # maximum thickness, as a fraction of the frame's shorter side
_NARROW = 0.1  # relative force error; squares and discs are below, rods as thin as a cell are above


def check_design(design: SensorDesign, mesh: tuple[int, int]) -> None:
    """Raise InputError for a membrane that the method cannot carry."""
    membrane = design.membrane
    short = min(design.frame.length, design.frame.width)
    if membrane.thickness > _THICKEST * short:
        raise InputError(
            f"{membrane.thickness * 1e3:g} is a plate, not a membrane, in a frame of "
            f"{short * 1e3:g} mm: the model omits bending; at most {_THICKEST * short * 1e3:g}",
            source=design.name,
            field="membrane.thickness_mm",
        )
    if membrane.pre_stretch < SLACKEST:
        raise InputError(
            f"{membrane.pre_stretch:g} leaves the membrane so slack that it folds; at least "
            f"{SLACKEST:g}",
            source=design.name,
            field="membrane.pre_stretch",
        )
    if mesh[0] * mesh[1] < 30:
        raise InputError(
            f"{mesh} vertices make heights wrong by more than 10 %; use at least (7, 5)",
            source="attach",
            field="mesh",
        )


def design_flags(design: SensorDesign, nx: int, ny: int) -> Reasons:
    """Return flags for errors of a design that occur under any load."""
    flags: Reasons = {}
    membrane = design.membrane
    frame = design.frame
    # second order; 1 % at 13 x 11 (tests/physics/test_membrane.py)
    error = 0.01 * 120 / ((nx - 1) * (ny - 1))
    if error > 0.02:
        flags["mesh"] = (
            f"mesh ({nx}, {ny}): heights and forces may be off by {error:.0%}; (13, 11) has 1-3 %"
        )
    rigidity = membrane.young * membrane.thickness**3 / (12 * (1 - membrane.poisson**2))
    wave = np.pi**2 * (1 / frame.length**2 + 1 / frame.width**2)
    # a bulge of 0.1 % strain
    tension = max(membrane.pretension, 0.0) + 1e-3 * membrane.young * membrane.thickness
    if rigidity * wave > _BENDING * tension:
        fraction = rigidity * wave / tension
        flags["bending"] = (
            f"bending, which the model omits, would add {fraction:.0%} to the stiffness of this "
            f"{membrane.thickness * 1e3:g} mm membrane; use a thinner or more stretched membrane"
        )
    return flags


def membrane_flags(
    design: SensorDesign, gauge_pressure: float, stretches: Array, areas: Array
) -> Reasons:
    """Return flags for stretch and compression of a membrane's present state.

    `stretches` (m, 2) are relative to the free membrane. `areas` (m,) m^2 are the triangles'.
    """
    flags: Reasons = {}
    membrane = design.membrane
    ninth = (9 * len(stretches)) // 10  # a few triangles at an edge do not make the bulge
    largest = float(np.partition(stretches[:, 1], ninth)[ninth])
    error = (
        analytical_solutions.stvk_height_error(design, gauge_pressure)
        if membrane.law is Law.STVK
        else 0.0
    )
    if error > STVK_ERROR:
        flags["stretch"] = (
            "the membrane has the St. Venant-Kirchhoff law: rubber bulges higher by "
            f"{error:.0%} at {1e-3 * gauge_pressure:.2g} kPa; switch 'hyperelasticity' on"
        )
    elif largest > STRETCHED:
        flags["stretch"] = (
            f"stretch {largest:.2f} exceeds {STRETCHED:g}, up to which rubber is neo-Hookean "
            "within 10 %; use less pressure or a thicker membrane"
        )
    # over a modulus
    stresses = principal_stresses(np.maximum(stretches, 0.1), 1.0, membrane.poisson, membrane.law)
    fraction = float(areas[stresses.min(axis=1) < -1e-3].sum() / areas.sum())
    if fraction > WRINKLED:
        flags["wrinkles"] = (
            f"{fraction:.0%} of the membrane is under compression, where a real one wrinkles: "
            "shape and force are those of a membrane without wrinkles; use pre_stretch above "
            "1 or more pressure"
        )
    return flags


def quasistatic_flags(below_rim: float, lowest: str, relative_error: float) -> Reasons:
    """Return flags of a quasi-static membrane.

    `below_rim` is the depth, m, of the geom `lowest` below the rim of the frame. `relative_error`
    is that of the force of a contact that is narrow for the grid.
    """
    flags: Reasons = {}
    if below_rim > 0:
        flags["rim_contact"] = (
            f"{lowest} lies on the frame's rim, {1e3 * below_rim:.2f} mm below the membrane's "
            "mid-surface there: the membrane's force may be off by 10 %; switch 'mesh' on"
        )
    if relative_error > _NARROW:
        flags["small_feature"] = (
            "a near object is narrow for the grid of the quasi-static membrane: 9 of 10 "
            f"forces are within {100 * relative_error:.0f} %; mjtactile.QuasistaticMembrane on a "
            "finer grid is more accurate"
        )
    return flags
