"""In-plane stiffness of sticking patches by radius and position, for the device (X7)."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import warp as wp

from mjtactile.core.types import Array
from mjtactile.quasistatic.membrane import QuasistaticMembrane
from mjtactile.sim.sensor.quasistatic_geoms import sticking_of
from mjtactile.warp.device.contact import StickingTable

_RADII, _COLUMNS, _ROWS = 10, 5, 4
_MAX_OFFSET = 0.8  # of half the frame
_MAX_RADIUS = 0.45  # of the smaller side


def sticking_table(membrane: QuasistaticMembrane) -> Any:
    """Return the table of a membrane, from the stiffness at rest of discs of nodes."""
    frame = membrane.design.frame
    dx, dy = (float(line[1] - line[0]) for line in (membrane.x, membrane.y))
    radii = np.geomspace(
        np.sqrt(dx * dy / np.pi), _MAX_RADIUS * min(frame.length, frame.width), _RADII
    )
    across = np.linspace(0, _MAX_OFFSET * frame.length / 2, _COLUMNS)
    along = np.linspace(0, _MAX_OFFSET * frame.width / 2, _ROWS)
    values = np.empty((_RADII, _COLUMNS, _ROWS, 3))
    for (i, x), (j, y) in product(enumerate(across), enumerate(along)):
        values[:, i, j] = _by_radius(membrane, radii, x, y)
    table = StickingTable()
    table.radii, table.columns, table.rows = _RADII, _COLUMNS, _ROWS
    table.first, table.ratio = float(radii[0]), float(np.log(radii[1] / radii[0]))
    table.step_x, table.step_y = float(across[1]), float(along[1])
    table.values = wp.array(values.reshape(-1, 3).astype(np.float32), dtype=wp.vec3)
    return table


def _by_radius(membrane: QuasistaticMembrane, radii: Array, x: float, y: float) -> Array:
    """Return the stiffness (radii, 3) of discs about (x, y), m, by the radius of their area."""
    sticking = sticking_of(membrane)
    cell = float(membrane.x[1] - membrane.x[0]) * float(membrane.y[1] - membrane.y[0])
    distance = np.hypot(membrane.x[:, None] - x, membrane.y - y)
    distance[[0, -1]] = distance[:, [0, -1]] = np.inf
    found: dict[float, Array] = {}
    for radius in np.unique([*radii, distance.min() + 1e-9]):
        held = distance <= max(radius, distance.min() + 1e-9)
        equal = float(np.sqrt(held.sum() * cell / np.pi))
        found[equal] = np.diag(sticking.grip(membrane.rest.x, held.astype(float)).stiffness)
    known = np.array(sorted(found))
    rows = np.log([found[radius] for radius in known])
    return np.exp(
        np.stack([np.interp(np.log(radii), np.log(known), rows[:, c]) for c in range(3)], axis=1)
    )
