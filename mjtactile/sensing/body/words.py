"""A fitted body in a user's words: curvatures, radius, direction, pose, outline."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from mjtactile.core.types import Array, FeltShape
from mjtactile.sensing.body.families import about, place_of, principal
from mjtactile.sensing.body.fit import Fit
from mjtactile.sensing.body.forward import Forward
from mjtactile.sensing.settings import BodySettings

_FINER = 4  # of the film's nodes, for an outline
_UNTOLD = math.pi / math.sqrt(12)  # rad, sd of a direction of which nothing is known


def words(
    forward: Forward,
    found: Fit,
    kind: str,
    probabilities: dict[str, float],
    scale: float,
    interval: tuple[float, float],
    s: BodySettings,
) -> FeltShape:
    """What is said of a body.

    Args:
        forward: The film.
        found: The body.
        kind: What it is called.
        probabilities: Of the kinds.
        scale: Factor on the fit's covariance, from its misfit.
        interval: m^2, of the area.
        s: Settings.

    Returns:
        The shape.
    """
    cov = found.cov_with(scale)
    family = found.family.name
    measures = _MEASURES[family](found.theta, cov, s)
    R, turn = _axes(found, measures.get("direction", 0.0))
    return FeltShape(
        kind,
        probabilities,
        area=found.area,
        area_interval=interval,
        p_SO=place_of(found.theta, found.hint),
        R_SO=R,
        pose_cov=_pose_cov(cov, turn),
        outline=_outline(forward, found),
        force_normal=s.friction * found.state.force_normal,
        family=family,
        misfit=found.misfit,
        **measures,
    )


def _smooth(theta: Array, cov: Array, s: BodySettings) -> dict[str, Any]:
    most, least, direction = principal(theta)
    step = 1e-3
    rows = np.array(
        [
            np.subtract(principal(theta + step * e)[:2], (most, least)) / step
            for e in np.eye(len(theta))
        ]
    ).T
    sd = np.sqrt(np.maximum(np.diag(rows @ cov @ rows.T), 0))
    bent = most - least
    direction_sd = min(math.sqrt(cov[4, 4]) / max(bent / 2, 1e-9) / 2, _UNTOLD)
    measures: dict[str, Any] = {
        "curvatures": (most, least),
        "curvatures_sd": sd,
        "direction": direction,
        "direction_sd": direction_sd,
    }
    mean = (most + least) / 2
    if least > 0 and most < s.ball_ratio * least:
        measures |= _radius(mean, math.hypot(*sd) / 2)
    return measures


def _radius(curvature: float, sd: float) -> dict[str, Any]:
    return {"radius": 1 / max(curvature, 1e-3), "radius_sd": sd / max(curvature, 1e-3) ** 2}


def _ball(theta: Array, cov: Array, s: BodySettings) -> dict[str, Any]:
    sd = math.sqrt(cov[3, 3])
    bent = {"curvatures": (theta[3], theta[3]), "curvatures_sd": (sd, sd)}
    return bent | _radius(theta[3], sd)


def _cylinder(theta: Array, cov: Array, s: BodySettings) -> dict[str, Any]:
    sd = math.sqrt(cov[3, 3])
    bent = {"curvatures": (theta[3], 0.0), "curvatures_sd": (sd, 0.0)}
    return bent | _radius(theta[3], sd) | _direction(theta[4], cov[4, 4])


def _direction(angle: float, variance: float) -> dict[str, Any]:
    return {"direction": angle % math.pi, "direction_sd": min(math.sqrt(variance), _UNTOLD)}


def _disc(theta: Array, cov: Array, s: BodySettings) -> dict[str, Any]:
    flat = {"curvatures": (0.0, 0.0), "curvatures_sd": (0.0, 0.0)}
    return flat | {"radius": 1e-3 * theta[5], "radius_sd": 1e-3 * math.sqrt(cov[5, 5])}


def _face(theta: Array, cov: Array, s: BodySettings) -> dict[str, Any]:
    flat = {"curvatures": (0.0, 0.0), "curvatures_sd": (0.0, 0.0)}
    return flat | _direction(theta[5], cov[5, 5])


_MEASURES = {"ball": _ball, "cylinder": _cylinder, "smooth": _smooth, "disc": _disc, "block": _face}

# Of each family the numbers that turn it about x, y and z of S (or, of an edge and a cylinder, of
# its own axes), where there are any.
_TURNS: dict[str, tuple[int | None, int | None, int | None]] = {
    "ball": (None, None, None),
    "cylinder": (None, 5, 4),
    "smooth": (None, None, None),
    "disc": (3, 4, None),
    "block": (3, 4, 5),
}


def _axes(found: Fit, direction: float) -> tuple[Array, tuple[int | None, int | None, int | None]]:
    """The body's axes in S, and which numbers turn it about x, y, z."""
    turns = _TURNS[found.family.name]
    x, y, _ = (0.0 if number is None else float(found.theta[number]) for number in turns)
    angle = direction
    if turns[2] is not None:
        angle = float(found.theta[turns[2]])
    return about(2, angle) @ about(1, y) @ about(0, x), turns


def _pose_cov(cov: Array, turns: tuple[int | None, int | None, int | None]) -> Array:
    """(6, 6) of place, m, and turns, rad; of what the family does not turn, nothing is known."""
    numbers = [0, 1, 2, *turns]
    units = np.array([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0])
    pose = np.zeros((6, 6))
    for i, a in enumerate(numbers):
        for j, b in enumerate(numbers):
            if a is not None and b is not None:
                pose[i, j] = units[i] * units[j] * cov[a, b]
        if a is None:
            pose[i, i] = np.nan
    return pose


def _outline(forward: Forward, found: Fit) -> Array:
    """Border (P, 2) m of where the film presses, between its nodes by its forces."""
    force = found.state.contact_forces
    nx, ny = force.shape
    if not (force > 0).any():
        return np.zeros((0, 2))
    columns, rows = np.meshgrid(
        np.linspace(0, nx - 1, _FINER * (nx - 1) + 1),
        np.linspace(0, ny - 1, _FINER * (ny - 1) + 1),
        indexing="ij",
    )
    places = np.stack([columns, rows])
    fine = map_coordinates(force, places, order=1)
    inside = (fine > 0.5 * float(np.median(force[force > 0]))).astype(np.uint8)
    contours, _ = cv2.findContours(inside, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return np.zeros((0, 2))
    b, a = max(contours, key=cv2.contourArea)[:, 0].T
    film, moved = forward.film, found.state.displacements
    at = np.stack([columns[a, b], rows[a, b]])
    border = []
    for nodes, shift, where in zip((film.x, film.y), moved[:2], at, strict=True):
        step = nodes[1] - nodes[0]
        border.append(nodes[0] + step * where + map_coordinates(shift, at, order=1))
    return np.column_stack(border)
