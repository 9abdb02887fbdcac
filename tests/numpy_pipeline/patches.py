"""Reference in numpy for the compiled stages of sensing/touch/patches.py.

The inverse cannot resolve pressure more sharply than its grid, but the second moment of a pressure
survives such a blur. It gives the area of a uniformly loaded disc. This area is too large where the
blur exceeds the contact. There the force is the better measure: a membrane on a ball carries the
pressure of its own tension in addition to the gas pressure. The outline encloses the highest
pressure, over that area.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, Contact
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.force.linearization import Shape
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from mjtactile.sensing.force.traction_grid import REFINE
from mjtactile.sensing.settings import DEFAULTS, PatchSettings


def find_patches(
    estimator: InverseMembrane, shape: Shape, rest: InverseRest, s: PatchSettings = DEFAULTS.patches
) -> tuple[Contact, ...]:
    """Return contact patches, the strongest first; empty without contact."""
    nx = len(estimator.x)
    ny = len(estimator.y)
    pressing = np.zeros((nx, ny))
    inner = (slice(1, -1), slice(1, -1))
    pressing[inner] = np.maximum(-shape.traction[2], 0).reshape(nx - 2, ny - 2)
    fine = _smoother(nx, s.smoothing) @ pressing @ _smoother(ny, s.smoothing).T
    peak = float(fine.max())
    if peak <= 0:
        return ()
    above = fine > min(
        s.separate_fraction * np.sqrt(max(shape.gauge_pressure, 0.1 * peak) * peak), 0.9 * peak
    )
    count, places = cv2.connectedComponents(above.astype(np.uint8), connectivity=4)
    position, cells = _fine_positions(estimator, shape)
    nodal = np.zeros((nx, ny, 3))
    nodal[inner] = (shape.traction * estimator.node_area).T.reshape(nx - 2, ny - 2, 3)
    sink = np.zeros((nx, ny))
    sink[inner] = -(estimator.node_positions(shape.c) - estimator.node_positions(rest.c))[
        :, 2
    ].reshape(nx - 2, ny - 2)
    owner = _nearest_place(places)
    total = max(-float(nodal[..., 2].sum()), 1e-9)
    patches = []
    for k in range(1, count):
        own = owner[::REFINE, ::REFINE] == k
        force = nodal[own].sum(axis=0)
        if -force[2] >= s.min_fraction * total:
            core = np.where(
                own, np.maximum(pressing - s.core_fraction * float(pressing.max()), 0), 0
            )
            field = np.where(owner == k, fine, 0)
            area = _area(
                core[inner].ravel(),
                position[::REFINE, ::REFINE][inner],
                -float(force[2]),
                shape.gauge_pressure,
                estimator,
                s,
            )
            inside = _strongest(field, cells, area)
            patches.append(
                _patch(
                    inside,
                    own,
                    np.maximum(field - s.core_fraction * peak, 0),
                    force,
                    position,
                    cells,
                    sink,
                )
            )
    return tuple(sorted(patches, key=lambda patch: float(patch.force[2])))


def _fine_positions(estimator: InverseMembrane, shape: Shape) -> tuple[Array, Array]:
    """Return positions (a, b, 3), m in S, of the fine grid's points, and the curved area (a, b),
    m^2, of each."""
    position = np.moveaxis(estimator.fine_positions(shape.c), 0, -1)
    across = position[:, 2:] - position[:, :-2]
    along = position[2:] - position[:-2]
    a = np.moveaxis(along[:, 1:-1], -1, 0)
    b = np.moveaxis(across[1:-1], -1, 0)
    cells = np.zeros(position.shape[:2])  # none on the frame itself
    cells[1:-1, 1:-1] = np.sqrt((a * a).sum(0) * (b * b).sum(0) - (a * b).sum(0) ** 2) / 4
    return position, cells


def _area(
    pressure: Array,
    p: Array,
    force: float,
    gauge: float,
    estimator: InverseMembrane,
    s: PatchSettings,
) -> float:
    """Estimate the area, m^2, of a patch that carries `force` N over a chamber at `gauge` Pa.

    It combines the force with the second moment of nodal pressures (J,) at `p` (jx, jy, 3). The
    extent of one node is the minimum of that moment.
    """
    p = p[..., :2].reshape(-1, 2)
    fraction = pressure * estimator.node_area
    fraction /= fraction.sum()
    off = p - fraction @ p
    variance = float(fraction @ (off * off).sum(axis=1)) / 2
    minimum = float(np.diff(estimator.x)[0] ** 2 + np.diff(estimator.y)[0] ** 2) / 24
    disc = 4 * np.pi * max(variance, minimum)
    observed = s.area_disc * (disc / s.area_disc) ** s.area_power
    carrying = force / (max(gauge, 0.0) + s.area_pressure)
    return float((observed**-s.area_blend + carrying**-s.area_blend) ** (-1 / s.area_blend))


def _strongest(field: Array, cells: Array, area: float) -> NDArray:
    """Select the cells (a, b) with the highest `field`, `area` m^2 in total; at least one."""
    order = np.argsort(field, axis=None)[::-1]
    filled = np.cumsum(cells.ravel()[order])
    count = max(1, min(int(np.searchsorted(filled, area)), int(np.count_nonzero(field))))
    inside = np.zeros(field.size, bool)
    inside[order[:count]] = True
    return inside.reshape(field.shape)


@cache
def _smoother(nodes: int, sd: float) -> Array:
    """Return the matrix (REFINE (nodes - 1) + 1, nodes) from nodes to the fine grid: Gaussian
    smoothing, `sd` in nodes, then linear."""
    index = np.arange(nodes)
    kernel = np.exp(-0.5 * (np.subtract.outer(index, index) / sd) ** 2)
    kernel /= kernel[nodes // 2].sum()
    fine = np.linspace(0, nodes - 1, REFINE * (nodes - 1) + 1)
    return np.maximum(1 - np.abs(np.subtract.outer(fine, index)), 0) @ kernel


def _nearest_place(places: NDArray) -> NDArray:
    """Return for each point the label of the nearest labelled position; 0 without one."""
    if places.max() <= 1:
        return np.full_like(places, places.max())
    _, nearest = cv2.distanceTransformWithLabels(
        (places == 0).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    owner = np.zeros(int(nearest.max()) + 1, dtype=places.dtype)
    owner[nearest[places > 0]] = places[places > 0]
    return owner[nearest]


def _patch(
    inside: NDArray,
    nodes: NDArray,
    weight: Array,
    force: Array,
    position: Array,
    cells: Array,
    sink: Array,
) -> Contact:
    """Return one patch from its fine cells `inside` (a, b), its grid nodes (nx, ny) and its
    pressure `weight` (a, b)."""
    fraction = weight / weight.sum()
    centroid = np.einsum("ab,abi->i", fraction, position[..., :2])
    area = float(cells[inside].sum())
    points = position[inside][:, :2]
    spread = _spread(points, cells[inside]) if len(points) > 2 else np.zeros((2, 2))
    values, vectors = np.linalg.eigh(spread)
    contours, _ = cv2.findContours(
        inside.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    b, a = max(contours, key=len)[:, 0].T
    mask = nodes & inside[::REFINE, ::REFINE]
    depth = float(sink[mask].max()) if mask.any() else float(sink[nodes].max())
    return Contact(
        True,
        area,
        centroid,
        max(depth, 0.0),
        mask.T,
        force=force,
        outline=position[a, b, :2],
        semi_axes=2 * np.sqrt(np.maximum(values[::-1], 0)),
        angle=float(np.arctan2(vectors[1, 1], vectors[0, 1])),
    )


def _spread(points: Array, weight: Array) -> Array:
    """Return second moments (2, 2) of weighted points (n, 2) about their mean."""
    fraction = weight / weight.sum()
    off = points - fraction @ points
    return (off.T * fraction) @ off
