"""Does the object slip on the membrane? From the share of friction that shear uses up, and from where the patch is.

Two signs. Coulomb: shear beyond friction times normal force cannot be held; long before, the rim of the contact slips
while its middle sticks, and the sticking share of the area is (1 - Q / mu N)^(2/3) (Cattaneo 1938, Mindlin 1949).
Kinematics: markers are material points, so the patch's centroid is known in the membrane's *material* coordinates.
While the object sticks it stays there, however much the membrane is dragged along; a patch that wanders over the
material slips (or rolls). The second needs the friction coefficient only to tell slip from rolling (Eq. F14).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mjtactile.sensing.inverse import InverseMembrane, Shape
from mjtactile.types import Array, Contact, Slip

INCIPIENT, SLIPPING = 0.7, 0.95  # shares of the friction limit
MEMORY = 0.05  # s, over which the patch's velocity is averaged
MOVED, SPEED = 2.5e-4, 4e-3  # m and m/s over the material: more than noise makes of a patch that sticks
LEAST_USED = 0.4  # share of the friction limit below which a wandering patch is taken for rolling or for a changed load
LEAST_FORCE = 0.05  # N; below, neither the patch nor its shear are known well enough
_FORGET = 1.0  # s, in which the point that the patch stuck to is forgotten while shear is low


@dataclass(frozen=True, eq=False)
class SlipHistory:
    """What the next frame needs: `time` s, the strongest patch's centroid `p` and the place `stuck` where it stuck
    (material coordinates, m), its `velocity` m/s, the `distance` m slipped, and the sensor file's `friction`."""

    time: float
    p: Array
    stuck: Array
    velocity: Array
    distance: float
    friction: float


def unknown(reason: str) -> Slip:
    return Slip("unknown", np.full(2, np.nan), np.nan, np.nan, status=reason)


def judge(time: float, estimator: InverseMembrane, shape: Shape, patches: Sequence[Contact],
          before: SlipHistory | None) -> tuple[Slip, SlipHistory | None]:
    """Slip state of the strongest patch at `time` s, and the history for the next frame (None: the touch has ended)."""
    if not patches:
        return Slip("none", np.zeros(2), 0.0, 1.0), None
    normal, shear = split(patches[0].force, mean_normal(estimator, shape))
    if normal < LEAST_FORCE:
        return unknown(f"a force of {normal:.3f} N is too small"), before
    p = material_centroid(estimator, shape)
    if before is None or time <= before.time:
        now = SlipHistory(time, p, p, np.zeros(2), 0.0, estimator.design.membrane.friction)
    else:
        now = _advance(before, time, p, used=float(np.linalg.norm(shear)) / (before.friction * normal))
    used = float(np.linalg.norm(shear)) / max(now.friction * normal, 1e-12)
    speed, moved = float(np.linalg.norm(now.velocity)), float(np.linalg.norm(now.p - now.stuck))
    wandering = used > LEAST_USED and (speed > SPEED or moved > MOVED)
    state = "slipping" if used > SLIPPING or wandering else "incipient" if used > INCIPIENT else "sticking"
    stick = max(0.0, 1 - used) ** (2 / 3)
    return Slip(state, now.velocity, now.distance, 0.0 if state == "slipping" else stick), now


def _advance(before: SlipHistory, time: float, p: Array, used: float) -> SlipHistory:
    """History after one more frame; `used` is the share of the friction limit."""
    step = time - before.time
    blend = step / (step + MEMORY)
    velocity = before.velocity + blend * ((p - before.p) / step - before.velocity)
    stuck, distance = before.stuck, before.distance
    if used < LEAST_USED:  # nothing can slip: what moved the patch was the load
        stuck = stuck + min(1.0, step / _FORGET + (used < LEAST_USED / 2)) * (p - stuck)
        distance = 0.0 if used < LEAST_USED / 2 else distance
    else:
        distance = max(distance, float(np.linalg.norm(p - stuck)))
    return SlipHistory(time, p, stuck, velocity, distance, before.friction)


def split(force: Array, normal: Array) -> tuple[float, Array]:
    """Normal force, N (positive presses), and shear (3,) N of a force on a patch with outward unit normal (3,)."""
    along = float(force @ normal)
    return -along, force - along * normal


def mean_normal(estimator: InverseMembrane, shape: Shape) -> Array:
    """Outward unit normal (3,) of the membrane, averaged over where it is pressed."""
    weight = estimator.pressing_at_points(shape)
    n = np.einsum("iab,ab->i", estimator.sheet.normals(shape.c), weight)
    return n / max(float(np.linalg.norm(n)), 1e-30) if weight.any() else np.array([0.0, 0.0, 1.0])


def material_centroid(estimator: InverseMembrane, shape: Shape) -> Array:
    """Centre of pressure (2,) m in the coordinates of the mounted flat sheet."""
    weight = np.maximum(-shape.traction[2], 0.0) * estimator.node_area
    weight = np.maximum(weight - 0.03 * weight.max(), 0.0)
    return weight @ estimator.nodes / weight.sum()
