"""Contact patches from the traction field (Eq. F13).

Each has outline, area, centroid, depth and axes. Several patches are possible at the same time. The
inverse solution cannot resolve pressure more sharply than its grid. But the second moment of a
pressure survives such a blur. It gives the area of a uniformly loaded disc. That area is too large
if the blur exceeds the contact. There the force gives the better estimate. On a sphere, a membrane
carries its own tension's pressure in addition to gas pressure. The outline encloses the region of
highest pressure that has this area. The arithmetic is in mjtactile/kernels/patches.c.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, Contact
from mjtactile.kernels import kernel
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.force.linearization import Shape
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from mjtactile.sensing.force.traction_grid import REFINE
from mjtactile.sensing.settings import DEFAULTS, PatchSettings, as_numbers

# Ends of the 68 % interval of an area, fitted to random presses (docs/theory/contact_shape.md)
_AREA_ABOVE = 1.8
_AREA_LOAD = 2.6e-3  # force over gauge pressure from which the area is the lower end, m^2
_AREA_POWER = 0.34
# relative ends for a flat contact: the standard deviation of its estimated force
_FLAT = (0.9, 1.1)
_ANY_DISC = 1e3  # m^2; the smaller estimate dominates, so that the area follows from the force


def find_patches(
    estimator: InverseMembrane, shape: Shape, rest: InverseRest, s: PatchSettings = DEFAULTS.patches
) -> tuple[Contact, ...]:
    """Return the contact patches, the strongest first; empty without contact. Under a plane, the
    membrane carries no pressure by its tension: area is force over gauge pressure."""
    is_flat = shape.gain.mean is not None
    if is_flat:
        s = replace(s, area_disc=_ANY_DISC, area_power=0.0, area_pressure=0.0)
    nx = len(estimator.x)
    ny = len(estimator.y)
    pressing = np.zeros((nx, ny))
    pressing[1:-1, 1:-1] = np.maximum(-shape.traction[2], 0).reshape(nx - 2, ny - 2)
    fine = _smoother(nx, s.smoothing) @ pressing @ _smoother(ny, s.smoothing).T
    peak = float(fine.max())
    if peak <= 0:
        return ()
    mean = math.sqrt(max(shape.gauge_pressure, 0.1 * peak) * peak)
    above = fine > min(s.separate_fraction * mean, 0.9 * peak)
    count, labels = cv2.connectedComponents(above.astype(np.uint8), connectivity=4)
    owner = _nearest_label(labels) if count > 2 else None
    position = estimator.fine_positions(shape.c)
    sunk = (estimator.node_positions(rest.c) - estimator.node_positions(shape.c))[:, 2]
    blur = ((estimator.x[1] - estimator.x[0]) ** 2 + (estimator.y[1] - estimator.y[0]) ** 2) / 24
    patches = []
    for k in range(1, count):
        inside = np.zeros(fine.shape, np.uint8)
        mask = np.empty((ny, nx), np.uint8)
        sums = np.empty(10)
        grids = (nx, ny, REFINE, *fine.shape, fine, position, owner, k)
        load = (shape.traction, estimator.node_area, sunk, shape.gauge_pressure, blur)
        if kernel("measure_patch")(*grids, *load, as_numbers(s), inside, mask, sums):
            found = _patch(inside, mask.view(bool), sums, position, shape.gauge_pressure)
            if is_flat:
                found = replace(found, area_interval=found.area * np.array(_FLAT))
            patches.append(found)
    return tuple(sorted(patches, key=lambda patch: float(patch.force[2])))


def together(patches: tuple[Contact, ...], grid_shape: tuple[int, int]) -> Contact:
    """Return all patches as one contact, on a grid of (ny, nx) nodes."""
    if not patches:
        return Contact(False, 0.0, np.full(2, np.nan), 0.0, np.zeros(grid_shape, bool))
    if len(patches) == 1:
        return patches[0]
    weights = np.array([-p.force[2] for p in patches])
    centroid = weights @ np.array([p.centroid for p in patches]) / weights.sum()
    return Contact(
        True,
        sum(p.area for p in patches),
        centroid,
        max(p.depth for p in patches),
        np.logical_or.reduce([p.mask for p in patches]),
        force=np.sum([p.force for p in patches], axis=0),
        area_interval=np.sum([p.area_interval for p in patches], axis=0),
    )


@cache
def _smoother(nodes: int, sd: float) -> Array:
    """Return the matrix (REFINE (nodes - 1) + 1, nodes) from nodes to the fine grid: Gaussian
    smoothing with `sd` in nodes, then linear interpolation."""
    index = np.arange(nodes)
    kernel = np.exp(-0.5 * (np.subtract.outer(index, index) / sd) ** 2)
    kernel /= kernel[nodes // 2].sum()
    fine = np.linspace(0, nodes - 1, REFINE * (nodes - 1) + 1)
    return np.maximum(1 - np.abs(np.subtract.outer(fine, index)), 0) @ kernel


def _nearest_label(labels: NDArray) -> NDArray:
    """Return the label of the nearest labeled position for each point; 0 if there is none."""
    if labels.max() <= 1:
        return np.full_like(labels, labels.max())
    _, nearest = cv2.distanceTransformWithLabels(
        (labels == 0).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    owner = np.zeros(int(nearest.max()) + 1, dtype=labels.dtype)
    owner[nearest[labels > 0]] = labels[labels > 0]
    return owner[nearest]


def _patch(
    inside: NDArray[np.uint8],
    mask: NDArray[np.bool_],
    sums: Array,
    position: Array,
    gauge_pressure: float,
) -> Contact:
    """Return one patch from its fine cells, its grid nodes and the kernel's results."""
    contours, _ = cv2.findContours(inside, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    b, a = max(contours, key=len)[:, 0].T
    x, y, depth, area, long, short, angle = sums[3:].tolist()
    return Contact(
        True,
        area,
        np.array([x, y]),
        depth,
        mask,
        force=sums[:3],
        outline=position[:2, a, b].T,
        semi_axes=np.array([long, short]),
        angle=angle,
        area_interval=_area_interval(area, -float(sums[2]), gauge_pressure),
    )


def _area_interval(area: float, force: float, gauge_pressure: float) -> Array:
    """Return the 68 % interval of the area (2,), m^2. The pressure of a light contact is not
    resolved, so the object may be much sharper than it appears."""
    load = max(force, 0.0) / max(gauge_pressure, 1.0)
    lower = min((load / _AREA_LOAD) ** _AREA_POWER, 1.0)
    return area * np.array([lower, _AREA_ABOVE])
