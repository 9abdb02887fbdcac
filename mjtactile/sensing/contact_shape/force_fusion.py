"""Fusion of the load on the estimated shape with the nodal force estimate
(docs/theory/contact_shape.md, Eq. F21)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mjtactile.core.normal_distribution import normal_cdf
from mjtactile.core.types import SHAPES, Array, Touch
from mjtactile.quasistatic import MembraneSolution
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.gauss_newton import Fit
from mjtactile.sensing.contact_shape.hypotheses import PressHistory
from mjtactile.sensing.contact_shape.primitives import principal
from mjtactile.sensing.settings import ContactShapeSettings

_NORMAL = 2
_BESIDE = 2.1  # node spacings of the membrane from the frame: its two outermost rows of nodes
_BELOW = 1e-4  # depth below the frame with full weight, m


@dataclass(frozen=True, eq=False)
class ContactLoad:
    """Load that indents the membrane with the estimated shape to its depth. `load` (3,) holds the
    normal force, N, and the torques about x and y, N m. The torques give the pressure center. `cov`
    is the covariance of `load`. `rows` (3, 6) map a wrench to these values. `explained` is the
    fraction of the variance due to sharp features that the shape explains."""

    load: Array
    cov: Array
    rows: Array
    explained: float


def contact_load(
    forward: ForwardModel, press: PressHistory, wrench: Array, noise: float, s: ContactShapeSettings
) -> ContactLoad:
    """Compute force and torques on the most likely shape, with covariance. It covers the parameter
    uncertainty, the errors of membrane and friction model, and the distance to the nodal estimate,
    weighted by the probability of another shape. Marker variances are multiplied by `noise`."""
    found = press.now
    state = found.state
    kinds = press.kinds(SHAPES)
    blunt = kinds["smooth"] + kinds["flat"]
    height, below = found.once("heights", lambda: _load_heights(forward, state))
    above = s.shear_above[1] + blunt * (s.shear_above[0] - s.shear_above[1])
    rows = np.zeros((3, 6))
    rows[0, 2] = rows[1, 3] = rows[2, 4] = 1.0
    # remove the torque of the shear force at that height
    rows[1, 1] = height + above
    rows[2, 0] = -(height + above)
    load = s.friction * rows @ state.wrench
    pointed = tip_probability(found, noise, s)
    uncertain = max(blunt, pointed)
    position_sd = s.position_sd_sharp + uncertain * (s.position_sd - s.position_sd_sharp)
    model = _model(load, max(found.misfit, 1.0), pointed, position_sd, below, s)
    shear = wrench[:2] - s.friction * state.wrench[:2]
    model[[1, 2], [1, 2]] += (s.shear_above_fraction * above * shear[::-1]) ** 2
    by_numbers = s.friction**2 * rows @ found.sums_cov_with(noise)[:6, :6] @ rows.T
    residual = load - rows @ wrench
    p_other = 1 - float(press.probabilities[0])
    left = (max(found.misfit, 1.0) / s.misfit_max) ** 2
    cov = model + by_numbers + p_other * np.outer(residual, residual)
    # The membrane catches on a point, while the model slides. Blunt shapes explain no sharp
    # features. If the markers show some, the contact may be a misclassified point.
    explains = kinds["edge"] + kinds["multiple"]
    return ContactLoad(load, cov, rows, max(1 - left, 0.0) * explains)


def _load_heights(forward: ForwardModel, state: MembraneSolution) -> tuple[float, float]:
    """Return the mean height of the contact force, m, and the force `below_frame`, N."""
    forces = state.contact_forces
    height = float((forces * state.heights).sum() / max(float(forces.sum()), 1e-9))
    return height, below_frame(forward, state)


def tip_probability(found: Fit, noise: float, s: ContactShapeSettings) -> float:
    """Return the probability of a point contact: both curvatures above a limit."""
    cov = found.cov_with(noise)
    if found.family.name == "ball":
        minimum = float(found.theta[3])
        variance = cov[3, 3]
    elif found.family.name == "smooth":
        minimum = principal(found.theta)[1]
        variance = max(cov[3, 3], cov[5, 5])
    else:
        return 0.0
    light = min(found.state.force_normal / s.tip_light, 1.0)
    limit = s.tip_curvature * math.sqrt(max(light, 0.0))
    return normal_cdf((minimum - limit) / math.sqrt(max(variance, 1.0)))


def below_frame(forward: ForwardModel, state: MembraneSolution) -> float:
    """Return the contact force within two spacings of the frame where the membrane is below it, N.
    Nodes less than `_BELOW` below are weighted in proportion. The model membrane is fixed at the
    frame, and long shapes end before it. So the model represents neither the membrane slope there
    nor the load on the last millimeters."""
    frame = forward.membrane.design.frame
    x, y = forward.nodes
    beside = np.minimum(frame.length / 2 - np.abs(x), frame.width / 2 - np.abs(y))
    lower = np.clip(-state.heights / _BELOW, 0.0, 1.0)
    near = beside < _BESIDE * forward.spacing
    return float((state.contact_forces * lower)[near].sum())


def _model(
    load: Array,
    misfit: float,
    pointed: float,
    position_sd: float,
    below: float,
    s: ContactShapeSettings,
) -> Array:
    """Return the covariance (3, 3) of membrane and friction model errors: force and its
    position."""
    force = abs(float(load[0]))
    fraction = math.hypot(s.force_fraction * misfit, s.tip_fraction * pointed)
    variance = s.force_sd**2 + (fraction * force) ** 2 + (s.frame_fraction * below) ** 2
    center = load[1:] / max(force, 1e-9)  # position of the pressure center
    jacobian = np.concatenate([[-1.0], center])
    cov = variance * np.outer(jacobian, jacobian)
    aside = misfit * (position_sd * force) ** 2 + s.torque_sd**2
    cov[1:, 1:] += aside * np.eye(2)
    return cov


def with_load(touch: Touch, known: ContactLoad, sharpness: Array) -> dict[str, Any]:
    """Return the fields of the touch that change if its wrench is fused with the load on the shape.
    `sharpness` is the part of the wrench variance (6,) due to sharp features that the nodal
    estimate cannot follow. The fraction explained by the shape is removed."""
    traction = touch.traction
    if traction is None:
        return {}
    P = traction.wrench_cov - known.explained * np.diag(sharpness)
    H = known.rows
    gain = np.linalg.solve(H @ P @ H.T + known.cov, H @ P).T
    wrench = traction.wrench + gain @ (known.load - H @ traction.wrench)
    left = np.eye(6) - gain @ H
    cov = left @ P @ left.T + gain @ known.cov @ gain.T
    shift = wrench[_NORMAL] - traction.wrench[_NORMAL]
    return {
        "traction": replace(traction, wrench=wrench, wrench_cov=cov),
        "force_normal": touch.force_normal - float(shift),
        "force_normal_sd": math.sqrt(cov[_NORMAL, _NORMAL]),
    }
