"""Force where the shape is known: what the film bears on the body that was found, with the nodal
estimate (docs/theory/contact_shape.md, Eq. F21)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.types import SHAPES, Array, Touch
from mjtactile.quasistatic import MembraneSolution
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.gauss_newton import Fit
from mjtactile.sensing.contact_shape.hypotheses import PressHistory
from mjtactile.sensing.contact_shape.primitives import principal
from mjtactile.sensing.contact_shape.stiction_factor import sticks
from mjtactile.sensing.settings import ContactShapeSettings

_NORMAL = 2
_BESIDE = 2.1  # spacings of the film: its two last rows of nodes
_BELOW = 1e-4  # m: what is so much lower than the frame, counts


@dataclass(frozen=True, eq=False)
class ContactLoad:
    """What a body that was found takes to be so deep in the sheet: normal force, N, and torques
    about x and y of where it presses, N m, `load` (3,) with covariance `cov`; they are the numbers
    `rows` (3, 6) of a wrench. It has `explained` so much of what is sharp in the markers, a share
    of the variance."""

    load: Array
    cov: Array
    rows: Array
    explained: float


def borne(
    forward: ForwardModel, press: PressHistory, wrench: Array, noise: float, s: ContactShapeSettings
) -> ContactLoad:
    """What the likeliest body bears.

    Args:
        forward: The film.
        press: What is known of what touches.
        wrench: (6,) as the nodal estimate has it.
        noise: Factor on the markers' variances.
        s: Settings.

    Returns:
        Force and torques, and how surely: by the body's numbers, by what film and friction leave,
        and, as far as it may be another body, by the nodal estimate's distance.
    """
    found = press.now
    state = found.state
    kinds = press.kinds(SHAPES)
    blunt = kinds["smooth"] + kinds["face"]
    forces = state.contact_forces
    height = float((forces * state.heights).sum() / max(float(forces.sum()), 1e-9))
    above = s.shear_above[1] + blunt * (s.shear_above[0] - s.shear_above[1])
    rows = np.zeros((3, 6))
    rows[0, 2] = rows[1, 3] = rows[2, 4] = 1.0
    # what shear does at that height is no part of it
    rows[1, 1] = height + above
    rows[2, 0] = -(height + above)
    more = sticks(forward, state, s)
    load = more * rows @ state.wrench
    pointed = _pointed(found, noise, s)
    untold = max(blunt, pointed)
    place = s.place_sd_sharp + untold * (s.place_sd - s.place_sd_sharp)
    model = _model(load, max(found.misfit, 1.0), pointed, place, below_frame(forward, state), s)
    shear = wrench[:2] - more * state.wrench[:2]
    model[[1, 2], [1, 2]] += (s.shear_above_fraction * above * shear[::-1]) ** 2
    by_numbers = more**2 * rows @ found.sums_cov_with(noise)[:6, :6] @ rows.T
    off = load - rows @ wrench
    doubt = 1 - float(press.probabilities[0])
    left = (max(found.misfit, 1.0) / s.misfit_max) ** 2
    cov = model + by_numbers + doubt * np.outer(off, off)
    # a point catches the sheet where the film slides; of what is blunt nothing is sharp, and where
    # markers say that something is, it may be a point that was taken for it
    explains = kinds["edge"] + kinds["several"]
    return ContactLoad(load, cov, rows, max(1 - left, 0.0) * explains)


def _pointed(found: Fit, noise: float, s: ContactShapeSettings) -> float:
    """How probably the sheet meets a point: more curved than a limit both ways."""
    from scipy.special import ndtr  # takes a while to import

    cov = found.cov_with(noise)
    if found.family.name == "ball":
        least = float(found.theta[3])
        variance = cov[3, 3]
    elif found.family.name == "smooth":
        least = principal(found.theta)[1]
        variance = max(cov[3, 3], cov[5, 5])
    else:
        return 0.0
    light = min(found.state.force_normal / s.tip_light, 1.0)
    limit = s.tip_curvature * math.sqrt(max(light, 0.0))
    return float(ndtr((least - limit) / math.sqrt(max(variance, 1.0))))


def below_frame(forward: ForwardModel, state: MembraneSolution) -> float:
    """Force, N, that presses the sheet lower than its frame, close beside it.

    A film is held at the frame, and bodies that go on end before it: how steeply the sheet hangs
    there, and what the last millimetres bear, it does not know.

    Args:
        forward: The film.
        state: Of it, on the body.

    Returns:
        The force of nodes within two spacings; of those less than `_BELOW` lower, a part.
    """
    frame = forward.film.design.frame
    x, y = forward.nodes
    beside = np.minimum(frame.length / 2 - np.abs(x), frame.width / 2 - np.abs(y))
    lower = np.clip(-state.heights / _BELOW, 0.0, 1.0)
    near = beside < _BESIDE * forward.spacing
    return float((state.contact_forces * lower)[near].sum())


def _model(
    load: Array, misfit: float, pointed: float, place: float, below: float, s: ContactShapeSettings
) -> Array:
    """Covariance (3, 3) of what film and friction leave: of the force, and of where it acts."""
    force = abs(float(load[0]))
    share = math.hypot(s.force_fraction * misfit, s.tip_fraction * pointed)
    variance = s.force_sd**2 + (share * force) ** 2 + (s.frame_fraction * below) ** 2
    places = load[1:] / max(force, 1e-9)  # of the middle of pressure
    turn = np.concatenate([[-1.0], places])
    cov = variance * np.outer(turn, turn)
    aside = misfit * (place * force) ** 2 + s.torque_sd**2
    cov[1:, 1:] += aside * np.eye(2)
    return cov


def with_load(touch: Touch, known: ContactLoad, sharpness: Array) -> Touch:
    """A touch whose wrench takes up what a body bears.

    Args:
        touch: As the nodal estimate has it.
        known: Of the body.
        sharpness: (6,) The part of its wrench's variance that is there since the nodal estimate
            does not follow what is sharp: as far as the body explains that, it is none.

    Returns:
        The touch with one wrench and one covariance of both.
    """
    traction = touch.traction
    if traction is None:
        return touch
    P = traction.wrench_cov - known.explained * np.diag(sharpness)
    H = known.rows
    gain = np.linalg.solve(H @ P @ H.T + known.cov, H @ P).T
    wrench = traction.wrench + gain @ (known.load - H @ traction.wrench)
    left = np.eye(6) - gain @ H
    cov = left @ P @ left.T + gain @ known.cov @ gain.T
    shift = wrench[_NORMAL] - traction.wrench[_NORMAL]
    return replace(
        touch,
        traction=replace(traction, wrench=wrench, wrench_cov=cov),
        force_normal=touch.force_normal - float(shift),
        force_normal_sd=float(np.sqrt(cov[_NORMAL, _NORMAL])),
    )
