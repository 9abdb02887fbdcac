"""Loads of MuJoCo's contacts on membrane and frame: `mj_contactForce` for many rows together."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core import geometry
from mjtactile.core.types import Array
from mjtactile.sim.sensor.quasistatic_sensor import QuasistaticSensor
from mjtactile.sim.sensor.sensor_types import AnySensor

_NEAR = 0.01  # distance from the rim that counts as near, m


def on_membrane(
    data: mujoco.MjData, sensor: AnySensor
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the rows (n,) of MuJoCo's contact list that involve the membrane, and flags (n, 2) of
    the membrane's side."""
    geom = data.contact.geom
    first = int(sensor.vertex_geom_ids[0])
    last = int(sensor.vertex_geom_ids[-1])
    sides = ((geom >= first) & (geom <= last)) | (data.contact.flex == sensor.flex_id)
    rows = (sides[:, 0] | sides[:, 1]).nonzero()[0]
    return rows, sides[rows]


def contact_points(data: mujoco.MjData, sensors: Sequence[AnySensor]) -> int:
    """Return the number of contact points on the sensors' membranes."""
    return sum(len(on_membrane(data, sensor)[0]) for sensor in sensors) if data.ncon else 0


def near_geoms(
    model: mujoco.MjModel, data: mujoco.MjData, sensor: AnySensor, geoms: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return those of `geoms` (n,) whose bounding balls are near the sensor's membrane."""
    offset = data.geom_xpos[geoms] - data.xpos[sensor.body_id]
    extent = _NEAR + np.hypot(sensor.design.frame.length, sensor.design.frame.width) / 2
    return geoms[np.linalg.norm(offset, axis=1) < model.geom_rbound[geoms] + extent]


def forces(
    data: mujoco.MjData, rows: NDArray[np.int64], sides: NDArray[np.bool_], R_WS: Array
) -> Array:
    """Return the forces (n, 3), N, in S that the contacts `rows` (n,) exert on their `sides` (n,
    2)."""
    contact = data.contact
    address = contact.efc_address[rows]
    dim = contact.dim[rows]
    force = np.zeros((len(rows), 3))
    for axis in range(3):
        pushes = (address >= 0) & (dim > axis)
        force[pushes, axis] = data.efc_force[address[pushes] + axis]
    # The rows of `frame` are the contact's axes in W; the force acts on the contact's second
    # entity.
    f_W = np.einsum("nk,nkj->nj", force, contact.frame[rows].reshape(-1, 3, 3))
    f_W *= np.where(sides[:, 1], 1.0, -1.0)[:, None]
    return f_W @ R_WS


def membrane_wrench(data: mujoco.MjData, sensor: AnySensor) -> Array:
    """Return the wrench (6,) on the membrane, frame S: force, N, and torque about the origin of S,
    N m."""
    if isinstance(sensor, QuasistaticSensor):
        return sensor.wrench
    R_WS = data.xmat[sensor.body_id].reshape(3, 3)
    rows, sides = on_membrane(data, sensor)
    f_S = forces(data, rows, sides, R_WS)
    points = (data.contact.pos[rows] - data.xpos[sensor.body_id]) @ R_WS
    return np.concatenate([f_S.sum(axis=0), geometry.cross(points, f_S).sum(axis=0)])


def frame_load(data: mujoco.MjData, sensor: AnySensor) -> tuple[float, int]:
    """Return the force, N, on the sensor's frame and housing, which no marker shows, and the geom
    with the largest; -1: none."""
    if not data.ncon:
        return 0.0, -1
    geom = data.contact.geom
    sides = (geom >= sensor.housing_geom_ids[0]) & (geom <= sensor.housing_geom_ids[-1])
    if not sides.any():
        return 0.0, -1
    rows = np.flatnonzero(sides.any(axis=1))
    R_WS = data.xmat[sensor.body_id].reshape(3, 3)
    f_S = forces(data, rows, sides[rows], R_WS)
    others = np.where(sides[rows, 1], geom[rows, 0], geom[rows, 1])
    return _largest(f_S, others)


def _largest(f_S: Array, owners: NDArray[np.int64]) -> tuple[float, int]:
    """Return the norm, N, of the sum of forces (n, 3), and the owner (n,) with the largest part."""
    if not len(owners):
        return 0.0, -1
    parts = {
        int(owner): float(np.linalg.norm(f_S[owners == owner].sum(axis=0))) for owner in owners
    }
    return float(np.linalg.norm(f_S.sum(axis=0))), max(parts, key=lambda owner: parts[owner])


def carried_load(
    data: mujoco.MjData, sensor: AnySensor, geoms: NDArray[np.int64]
) -> tuple[float, int]:
    """Return the force, N, on `geoms` in front of the sensor's glass, and the geom with the
    largest.

    It includes the membrane's own vertices, which a sensor fixed to the world presses onto them.
    """
    if not len(geoms) or not data.ncon:
        return 0.0, -1
    contact = data.contact
    mine = np.isin(contact.geom, geoms)
    rows = np.flatnonzero(mine[:, 0] != mine[:, 1])
    if not len(rows):
        return 0.0, -1
    R_WS = data.xmat[sensor.body_id].reshape(3, 3)
    frame = sensor.design.frame
    p_S = (contact.pos[rows] - data.xpos[sensor.body_id]) @ R_WS
    half = np.array([frame.length, frame.width]) / 2 + frame.rim
    near = (np.abs(p_S[:, :2]) < half).all(axis=1) & (p_S[:, 2] > -sensor.design.chamber.depth)
    rows = rows[near]
    sides = mine[rows]
    f_S = forces(data, rows, sides, R_WS)
    owners = np.where(sides[:, 1], contact.geom[rows, 1], contact.geom[rows, 0])
    return _largest(f_S, owners)
