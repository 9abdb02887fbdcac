"""Geoms of a sensor's carrier within reach of the membrane: their contacts bypass the sensor.

The carrier is the part of the robot to which the sensor is fixed. An object that presses the
membrane down to such a geom is carried by the geom, and no marker shows that force.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core import analytical_solutions
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.sim.sensor import feature_size
from mjtactile.sim.sensor.sensor_types import AnySensor

_TOUCHING = 2e-4  # overlap that counts as adjacent, m


def carrier_geoms(
    model: mujoco.MjModel, data: mujoco.MjData, sensor: AnySensor
) -> NDArray[np.int64]:
    """Return the geoms (n,) of the carrier within the chamber or the membrane's reach.

    The poses of `data` must be up to date. Geoms without contacts do not count.
    """
    welds = feature_size.weld_bodies(model)
    fixed = welds[model.geom_bodyid] == welds[sensor.body_id]
    fixed[sensor.housing_geom_ids] = False
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    convex = ~np.isin(model.geom_type, (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD))
    regions = _regions(sensor.design)
    found = [
        geom
        for geom in np.flatnonzero(fixed & solid & convex).tolist()
        if any(_overlaps(model, data, sensor, geom, *region) for region in regions)
    ]
    return np.array(found, np.int64)


def _regions(design: SensorDesign) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return center and half-extents, m, frame S, of the chamber and of the bulge with its rim."""
    frame = design.frame
    depth = design.chamber.depth
    opening = np.array([frame.length, frame.width]) / 2
    top = analytical_solutions.bulge_height(design, design.chamber.supply_gauge)
    boxes = ((opening, -depth, top), (opening + frame.rim, 0.0, top))
    first, second = (
        (np.array([0.0, 0.0, (low + high) / 2]), np.array([*half, (high - low) / 2]) - _TOUCHING)
        for half, low, high in boxes
    )
    return first, second


def _overlaps(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    sensor: AnySensor,
    geom: int,
    center: Array,
    half: Array,
) -> bool:
    """Return True if a geom overlaps a box in S.

    A box of the housing, moved there for one query, measures the distance.
    """
    probe = int(sensor.housing_geom_ids[0])
    R_WS = data.xmat[sensor.body_id].reshape(3, 3)
    geom_values = (model.geom_size[probe], data.geom_xpos[probe], data.geom_xmat[probe])
    kept = [value.copy() for value in geom_values]
    try:
        geom_values[0][:] = half
        geom_values[1][:] = data.xpos[sensor.body_id] + R_WS @ center
        geom_values[2][:] = R_WS.ravel()
        # below a positive limit, so that an overlap is negative
        return mujoco.mj_geomDistance(model, data, probe, geom, 1e-3, None) < 0
    finally:
        for value, old in zip(geom_values, kept, strict=True):
            value[:] = old


def exclude(model: mujoco.MjModel, geoms: NDArray[np.int64]) -> None:
    """Switch off the contacts of `geoms`. The sensor's housing is in their place."""
    model.geom_contype[geoms] = 0
    model.geom_conaffinity[geoms] = 0


def carrier_note(model: mujoco.MjModel, sensor: AnySensor, geoms: NDArray[np.int64]) -> str:
    """Return a note on `geoms` of the carrier and the remedy; empty without any."""
    if not len(geoms):
        return ""
    return (
        f"objects can rest on {names_of(model, geoms)} of its carrier instead of the membrane: "
        f"{remedy(sensor)}, or use attach(..., carrier_contact=False)"
    )


def names_of(model: mujoco.MjModel, geoms: NDArray[np.int64]) -> str:
    """Return the quoted names of geoms."""
    return ", ".join(repr(feature_size.name_of(model, int(geom))) for geom in geoms)


def remedy(sensor: AnySensor) -> str:
    """Return the changes of a scene that keep objects off the carrier."""
    return (
        f"move the site until the carrier is {1e3 * sensor.design.chamber.depth:g} mm or more "
        "behind it, or set contype and conaffinity of the geom to 0"
    )
