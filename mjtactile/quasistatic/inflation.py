"""First equilibrium of a quasi-static membrane, without contact."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mjtactile.core import analytical_solutions
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.kernels import kernel
from mjtactile.quasistatic.cut_cells import free_nodes
from mjtactile.quasistatic.obstacles import NUMBERS
from mjtactile.quasistatic.solution import FOUND, FRICTIONLESS, MembraneSolution

if TYPE_CHECKING:
    from mjtactile.quasistatic.membrane import QuasistaticMembrane

_INFLATING = (0.25, 0.5, 0.75, 1.0)  # of the pressure
_TAUT = 1.02  # minimum stretch during inflation, reduced to the actual one afterwards
_LETTING_GO = (1.0, 0.5, 0.25, 0.0)  # fractions of the additional stretch
_INFLATED = 1e-9  # tolerance of the displacements, m
_MAX_STEPS = 160
_STRETCH_SQUARED = 4  # index in the membrane's parameters


def inflate(membrane: QuasistaticMembrane) -> MembraneSolution:
    """Find the inflated equilibrium of a membrane. Raises InputError if there is none.

    The start is a low bulge of about the right height. The stiffness matrices are factored again at
    each pressure step. The last factors are kept for all solutions. A membrane without pre-stretch
    does not converge, so it is first inflated with additional stretch.
    """
    x = _low_bulge(membrane)
    force = np.zeros(membrane.grid)
    found = np.empty(FOUND)
    for fraction, stretch in _ways(membrane.design.membrane.pre_stretch):
        membrane._constants[_STRETCH_SQUARED] = stretch**2
        try:
            _keep(membrane, x)
        except np.linalg.LinAlgError:
            break
        pressure = fraction * membrane.gauge_pressure
        settings = np.array([pressure, 0.0, _INFLATED, _MAX_STEPS, 1.0, 0.0, *FRICTIONLESS])
        trend = np.zeros((4, *membrane.grid))
        membrane._run(settings, np.zeros((0, NUMBERS)), None, (x, force, trend, found))
        if not MembraneSolution(x, force, found).converged:
            break
    else:
        return MembraneSolution(x, force, found)
    raise InputError(
        f"sensor {membrane.design.name}: no equilibrium of the membrane was found at "
        f"{membrane.gauge_pressure:g} Pa",
        field="gauge_pressure",
    )


def inflated_further(membrane: QuasistaticMembrane, pressure: float) -> MembraneSolution:
    """Find the equilibrium without contact at a gauge `pressure`, Pa, close to that at rest."""
    x, force, trend = membrane.rest.x.copy(), np.zeros(membrane.grid), np.zeros((4, *membrane.grid))
    found = np.empty(FOUND)
    settings = np.array([pressure, 0.0, _INFLATED, _MAX_STEPS, 1.0, 0.0, *FRICTIONLESS])
    membrane._run(settings, np.zeros((0, NUMBERS)), None, (x, force, trend, found))
    return MembraneSolution(x, force, found)


def _ways(stretch: float) -> Iterator[tuple[float, float]]:
    """Yield the fraction of the pressure and the stretch of each inflation step."""
    more = max(_TAUT - stretch, 0.0)
    for fraction in _INFLATING:
        yield fraction, stretch + more
    for left in _LETTING_GO:
        if more > 0:
            yield 1.0, stretch + left * more
    yield 1.0, stretch


def _low_bulge(membrane: QuasistaticMembrane) -> Array:
    frame = membrane.design.frame
    outline = frame.outline
    known = (
        membrane.design
        if outline is None
        else replace(membrane.design, frame=replace(frame, shape="ellipse"))
    )
    height = analytical_solutions.bulge_height(known, _INFLATING[0] * membrane.gauge_pressure)
    if not np.isfinite(height):
        height = 0.1 * min(frame.length, frame.width)
    x = np.zeros((3, *membrane.grid))
    if outline is None:
        across = (membrane.x / membrane.x[-1])[:, None]
        along = membrane.y / membrane.y[-1]
        x[2] = height * (1 - across**2) * (1 - along**2)
    else:
        nodes = np.stack(np.meshgrid(membrane.x, membrane.y, indexing="ij"), axis=-1).reshape(-1, 2)
        within = 1 - np.square(outline.disc(nodes)).sum(axis=1)
        x[2] = height * within.reshape(membrane.grid) * free_nodes(membrane._cut, membrane.grid)
    return x


def _keep(membrane: QuasistaticMembrane, x: Array) -> None:
    """Store the factors of the stiffness at displacements `x` for all later solutions."""
    fixed = (membrane._constants, membrane._law, *membrane.grid)
    given = (x, membrane._room.size, membrane._room, membrane._kept.size, membrane._kept)
    kernel("qs_factorize")(*fixed, *given)
