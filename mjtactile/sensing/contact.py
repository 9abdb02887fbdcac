"""Where the object touches: from the traction field, with the indentation against the rest shape as a check."""

from __future__ import annotations

import numpy as np

from mjtactile.types import Array, Contact, Surface

# A contact presses everywhere inside its outline and not at all outside; smoothed by the marker spacing, the outline
# lies where the pressure has fallen to about half of its plateau.
_OUTLINE_SHARE = 0.5


def find_contact(surface: Surface, rest: Surface, normal_force: Array, *, touching: bool) -> Contact:
    """Contact patch from `normal_force` (ny, nx), N per grid node pressing inwards, on the grid of `surface`.

    `touching` is the verdict of the net force; without it the patch is empty. Area is that of the curved surface.
    """
    indentation = rest.z - surface.z
    mask = np.zeros(surface.z.shape, bool)
    if touching:
        mask = (normal_force > _OUTLINE_SHARE * np.max(normal_force)) & (indentation > 0)
    if not mask.any():
        return Contact(False, 0.0, np.full(2, np.nan), 0.0, mask)
    weight = np.where(mask, normal_force, 0.0)
    centroid = np.array([(weight.sum(0) @ surface.x), (weight.sum(1) @ surface.y)]) / weight.sum()
    return Contact(True, float(np.sum(_node_areas(surface)[mask])), centroid, float(indentation[mask].max()), mask)


def _node_areas(surface: Surface) -> Array:
    """Area of curved surface that each grid node stands for, (ny, nx) m^2."""
    slope_y, slope_x = np.gradient(surface.z, surface.y, surface.x)
    cell = np.outer(np.gradient(surface.y), np.gradient(surface.x))
    return cell * np.sqrt(1 + slope_x**2 + slope_y**2)
