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

from mjtactile.core.status import Status, StatusCode
from mjtactile.core.types import Array, Contact, Slip
from mjtactile.sensing.force.inverse import InverseMembrane, Shape
from mjtactile.sensing.settings import DEFAULTS, SlipSettings


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


def unknown(code: StatusCode, reason: str) -> Slip:
    return Slip("unknown", np.full(2, np.nan), np.nan, np.nan, status=Status(code, reason))


def judge(time: float, estimator: InverseMembrane, shape: Shape, patches: Sequence[Contact],
          before: SlipHistory | None, s: SlipSettings = DEFAULTS.slip) -> tuple[Slip, SlipHistory | None]:
    """Slip state of the strongest patch at `time` s, and the history for the next frame (None: the touch has ended)."""
    if not patches:
        return Slip("none", np.zeros(2), 0.0, 1.0), None
    normal, shear = split(patches[0].force, mean_normal(estimator, shape))
    if normal < s.least_force:
        return unknown(StatusCode.TOO_WEAK, f"a force of {normal:.3f} N is too small"), before
    p = material_centroid(estimator, shape, s.core_share)
    if before is None or time <= before.time:
        now = SlipHistory(time, p, p, np.zeros(2), 0.0, estimator.design.membrane.friction)
    else:
        now = _advance(before, time, p, used=float(np.linalg.norm(shear)) / (before.friction * normal), s=s)
    used = float(np.linalg.norm(shear)) / max(now.friction * normal, 1e-12)
    speed, moved = float(np.linalg.norm(now.velocity)), float(np.linalg.norm(now.p - now.stuck))
    wandering = used > s.least_used and (speed > s.speed or moved > s.moved)
    state = "slipping" if used > s.slipping or wandering else "incipient" if used > s.incipient else "sticking"
    stick = max(0.0, 1 - used) ** (2 / 3)
    return Slip(state, now.velocity, now.distance, 0.0 if state == "slipping" else stick), now


def _advance(before: SlipHistory, time: float, p: Array, used: float, s: SlipSettings) -> SlipHistory:
    """History after one more frame; `used` is the share of the friction limit."""
    step = time - before.time
    blend = step / (step + s.memory)
    velocity = before.velocity + blend * ((p - before.p) / step - before.velocity)
    stuck, distance = before.stuck, before.distance
    if used < s.least_used:  # nothing can slip: what moved the patch was the load
        stuck = stuck + min(1.0, step / s.forget + (used < s.least_used / 2)) * (p - stuck)
        distance = 0.0 if used < s.least_used / 2 else distance
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


def material_centroid(estimator: InverseMembrane, shape: Shape, core_share: float = DEFAULTS.slip.core_share) -> Array:
    """Centre of pressure (2,) m in the coordinates of the mounted flat sheet; less than `core_share` of the peak is no touch."""
    weight = np.maximum(-shape.traction[2], 0.0) * estimator.node_area
    weight = np.maximum(weight - core_share * weight.max(), 0.0)
    return weight @ estimator.nodes / weight.sum()
