"""Where the method ends: what is refused when a scene is built, flagged while it runs, or stops it.

A refusal (InputError) or a stop (SimulationError) is for numbers that would be wrong; a flag is for
numbers that are worse than usual, with the reason and the nearest setting that works. Never a wrong
number silently.
"""

from __future__ import annotations

import numpy as np

from mjtactile.core import analytical_solutions
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.neo_hookean import Law, principal_stresses
from mjtactile.core.types import Array

Flags = dict[str, str]
"""Kind of doubt ("stretch", "wrinkles", "penetration", "mesh", "feature", "edge", "hull",
"bending", "speed", "solver", "frame", "rim", "unsettled", "strain" of a soft object) to its
reason."""

GROWS = frozenset({"frame"})
"""Kinds whose reason says how much: it is replaced when there is more."""
STVK_ERROR = 0.02  # share of a height
# against the free sheet; beyond, real rubber (Treloar 1944) is more than about 10 % off the
# neo-Hookean law
STRETCHED = 1.4
WRINKLED = 0.01  # share of the sheet under compression
SLACKEST = 0.95
_BENDING = 0.05  # share of the bulge's stiffness
_THICKEST = 0.1  # of the frame's shorter side
_NARROW = 0.1  # share of a film's force: squares and discs are within, rods as thin as a cell not


def check_design(design: SensorDesign, mesh: tuple[int, int]) -> None:
    """Refuse a membrane that the method cannot carry. Raises InputError naming field, value and
    nearest good value."""
    sheet = design.membrane
    short = min(design.frame.length, design.frame.width)
    if sheet.thickness > _THICKEST * short:
        raise InputError(
            f"{sheet.thickness * 1e3:g} is a plate, not a membrane, in a frame of {short * 1e3:g} "
            f"mm: bending is left out; at most {_THICKEST * short * 1e3:g}",
            source=design.name,
            field="membrane.thickness_mm",
        )
    if sheet.pre_stretch < SLACKEST:
        raise InputError(
            f"{sheet.pre_stretch:g} leaves the sheet so slack that it folds; at least {SLACKEST:g}",
            source=design.name,
            field="membrane.pre_stretch",
        )
    if mesh[0] * mesh[1] < 30:
        raise InputError(
            f"{mesh} vertices make heights wrong by more than 10 %; at least (7, 5)",
            source="attach",
            field="mesh",
        )


def design_flags(design: SensorDesign, nx: int, ny: int) -> Flags:
    """What a design's numbers suffer from whatever happens to it."""
    flags: Flags = {}
    sheet = design.membrane
    frame = design.frame
    # second order; 1 % at 13 x 11 (tests/physics/test_membrane.py)
    error = 0.01 * 120 / ((nx - 1) * (ny - 1))
    if error > 0.02:
        flags["mesh"] = (
            f"mesh ({nx}, {ny}): heights and forces may be off by {error:.0%}; (13, 11) has 1-3 %"
        )
    rigidity = sheet.young * sheet.thickness**3 / (12 * (1 - sheet.poisson**2))
    wave = np.pi**2 * (1 / frame.length**2 + 1 / frame.width**2)
    # a bulge of 0.1 % strain
    tension = max(sheet.pretension, 0.0) + 1e-3 * sheet.young * sheet.thickness
    if rigidity * wave > _BENDING * tension:
        share = rigidity * wave / tension
        flags["bending"] = (
            f"bending, which is left out, would add {share:.0%} to the stiffness of this "
            f"{sheet.thickness * 1e3:g} mm sheet; a thinner or more stretched sheet is a membrane"
        )
    return flags


def membrane_flags(
    design: SensorDesign, gauge_pressure: float, stretches: Array, areas: Array
) -> Flags:
    """What makes the present state of the sheet less good than it looks: stretch, compression.

    Args:
        design: The sensor.
        gauge_pressure: Of its chamber, Pa.
        stretches: Principal stretches (m, 2), small and large, of the triangles against the free
            sheet.
        areas: Their areas (m,) m^2.
    """
    flags: Flags = {}
    sheet = design.membrane
    ninth = (9 * len(stretches)) // 10  # a few triangles at an edge do not make the bulge
    largest = float(np.partition(stretches[:, 1], ninth)[ninth])
    error = (
        analytical_solutions.stvk_height_error(design, gauge_pressure)
        if sheet.law is Law.STVK
        else 0.0
    )
    if error > STVK_ERROR:
        flags["stretch"] = (
            f"the sheet is St. Venant-Kirchhoff's: rubber bulges higher by {error:.0%} at "
            f"{1e-3 * gauge_pressure:.2g} kPa; switch 'hyperelasticity' on"
        )
    elif largest > STRETCHED:
        flags["stretch"] = (
            f"stretch {largest:.2f} is beyond {STRETCHED:g}, up to which rubber is neo-Hookean "
            "within 10 %; use less pressure or a thicker sheet"
        )
    # over a modulus
    stresses = principal_stresses(np.maximum(stretches, 0.1), 1.0, sheet.poisson, sheet.law)
    share = float(areas[stresses.min(axis=1) < -1e-3].sum() / areas.sum())
    if share > WRINKLED:
        flags["wrinkles"] = (
            f"{share:.0%} of the sheet is under compression, where a real one wrinkles: shape "
            "and force are those of a sheet that cannot; use pre_stretch above 1 or more pressure"
        )
    return flags


def quasistatic_flags(below_rim: float, doubt: float) -> Flags:
    """Flags of a film: what is `below_rim` m where the frame bears it, and the share of the force
    by which what is narrow for its grid may be off."""
    flags: Flags = {}
    if below_rim > 0:
        flags["rim"] = (
            f"what touches lies on the frame's rim ({1e3 * below_rim:.2f} mm below the sheet's "
            "middle there): what the sheet bears on it is the frame's, not the film's"
        )
    if doubt > _NARROW:
        flags["feature"] = (
            "what is near is narrow for the film's grid: 9 of 10 forces are within "
            f"{100 * doubt:.0f} %; mjtactile.Film on a finer grid says more"
        )
    return flags
