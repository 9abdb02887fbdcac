"""Where the object touches: from the traction field, with the indentation against the rest shape as
a check."""

from __future__ import annotations

import numpy as np

from benchmarks.paper.settings import DEFAULTS, PaperSettings
from mjtactile.core.bspline import hats
from mjtactile.core.types import Array, Contact, Surface, Traction


def find_contact(
    surface: Surface,
    rest: Surface,
    traction: Traction,
    *,
    touching: bool,
    s: PaperSettings = DEFAULTS,
) -> Contact:
    """Contact patch on the grid of `traction`: where it presses, and the surface is further in than
    at rest.

    `touching` is the verdict of the net force; without it the patch is empty. Area is that of the
    curved surface. A contact presses everywhere inside its outline and not at all outside; smoothed
    by the marker spacing, the outline lies where the pressure has fallen to about half of its
    plateau.
    """
    pressing = -traction.force[..., 2]
    height = resample(surface, traction.x, traction.y)
    indentation = resample(rest, traction.x, traction.y) - height
    mask = np.zeros(pressing.shape, bool)
    if touching:
        mask = (pressing > s.outline_share * np.max(pressing)) & (indentation > 0)
    if not mask.any():
        return Contact(False, 0.0, np.full(2, np.nan), 0.0, mask)
    weight = np.where(mask, pressing, 0.0)
    centroid = np.array([weight.sum(0) @ traction.x, weight.sum(1) @ traction.y]) / weight.sum()
    area = float(np.sum(_node_areas(traction.x, traction.y, height)[mask]))
    return Contact(True, area, centroid, float(indentation[mask].max()), mask)


def resample(surface: Surface, x: Array, y: Array) -> Array:
    """Heights (len(y), len(x)) m of a surface on another grid, bilinear."""
    return hats(surface.y, y)[0] @ surface.z @ hats(surface.x, x)[0].T


def _node_areas(x: Array, y: Array, z: Array) -> Array:
    """Area of curved surface that each grid node stands for, (ny, nx) m^2."""
    slope_y, slope_x = np.gradient(z, y, x)
    return np.outer(np.gradient(y), np.gradient(x)) * np.sqrt(1 + slope_x**2 + slope_y**2)
