"""Borders between bodies that touch one membrane side by side, as Warp functions.

The rule of kernels/qs_contact_patches.c.
"""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.fields import Fields
from mjtactile.warp.device.grid import MembraneGrid, node_at
from mjtactile.warp.device.obstacles import MISS, Geom, is_on, obstacle_height

wp.set_module_options({"enable_backward": False})


@wp.func
def find_borders(
    membrane: MembraneGrid,
    geoms: wp.array2d(dtype=Geom),
    pool: wp.array(dtype=wp.vec4),
    fields: Fields,
    slot_of: wp.array2d(dtype=int),
    f: int,
    finger: int,
    lane: int,
    threads: int,
) -> None:
    """Find the next body over the cell of each node in contact, and the fraction of the cell under
    it: the force moves gradually from one body to the next as their border crosses the cell.

    The difference of their heights is linear over the cell.
    """
    for k in range(lane, membrane.nx * membrane.ny, threads):
        owner = fields.owner[f, k]
        fraction = float(0.0)
        other = int(-1)
        if fields.force[f, k] > 0.0 and owner >= 0:
            i = k // membrane.ny
            at = node_at(membrane, fields.u, f, i, k - i * membrane.ny)
            own = wp.vec3(MISS, 0.0, 0.0)
            best = wp.vec3(MISS, 0.0, 0.0)
            for g in range(geoms.shape[1]):
                geom = geoms[f, g]
                if geom.kind >= 0:
                    found = obstacle_height(geom, pool, membrane.half_thickness, at[0], at[1])
                    if slot_of[finger, g] == slot_of[finger, owner]:
                        if found[0] < own[0]:
                            own = found
                    elif found[0] < best[0] and found[0] < membrane.roof:
                        best = found
                        other = slot_of[finger, g]
            if is_on(own[0]) and is_on(best[0]):
                range_x = wp.abs(best[1] - own[1]) * membrane.dx
                range_y = wp.abs(best[2] - own[2]) * membrane.dy
                over = wp.max(range_x + range_y, 1.0e-12)
                fraction = wp.clamp(0.5 - (best[0] - own[0]) / over, 0.0, 1.0)
        fields.next_slot[f, k] = other
        fields.next_fraction[f, k] = fraction


@wp.func
def force_on(
    fields: Fields, slot_of: wp.array2d(dtype=int), f: int, finger: int, slot: int, k: int
) -> float:
    """Return the force of a node, N, on the body of `slot`."""
    found = float(0.0)
    q = fields.force[f, k]
    owner = fields.owner[f, k]
    if q > 0.0 and owner >= 0:
        if slot_of[finger, owner] == slot:
            found = q * (1.0 - fields.next_fraction[f, k])
        elif fields.next_slot[f, k] == slot:
            found = q * fields.next_fraction[f, k]
    return found
