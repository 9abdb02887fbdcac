"""Check of initial contacts with the sensors of a scene.

It rejects an object that the jaws touch at the start, or a gripper that touches itself.
"""

from __future__ import annotations

from mjtactile.core.errors import InputError
from mjtactile.sim.scenes.objects import PREFIX, ObjectModel
from mjtactile.sim.scenes.world import World
from mjtactile.sim.sensor.sensor_types import AnySensor


def touched_by_sensors(world: World) -> set[tuple[str, str, str]]:
    """Return sensor prefix, MuJoCo body ("": a flex) and geom of contacts with sensors."""
    found = set()
    for contact in world.data.contact:
        if contact.exclude:  # near, but not touching
            continue
        sides = list(zip(contact.geom, contact.flex, strict=True))
        for side, other in (sides, sides[::-1]):
            owner = next(
                (sensor for sensor in world.sensors if _is_part(world, sensor, *side)), None
            )
            if owner is not None and not any(
                _is_part(world, sensor, *other) for sensor in world.sensors
            ):
                found.add((owner.prefix, *_names(world, *other)))
    return found


def require_clear(world: World, grasped: ObjectModel, opening: float) -> None:
    """Raise InputError for an object that touches a sensor in the initial state."""
    if any(not body or body.startswith(PREFIX) for _, body, _ in touched_by_sensors(world)):
        raise InputError(
            f"touches a sensor before the jaws close: they open to {1e3 * opening:.0f} mm, "
            "and the object is wider there or not centered",
            source=grasped.path,
            field="object",
        )


def _is_part(world: World, sensor: AnySensor, geom: int, flex: int) -> bool:
    """Return True if a side of a contact is the sensor's housing or membrane."""
    if geom < 0:
        return flex == sensor.flex_id
    body = int(world.model.geom_bodyid[geom])
    return sensor.body_id in (body, int(world.model.body_parentid[body]))


def _names(world: World, geom: int, flex: int) -> tuple[str, str]:
    if geom < 0:
        return "", f"flex {flex}"
    body = world.model.body(int(world.model.geom_bodyid[geom])).name
    return body or "world", world.model.geom(int(geom)).name or f"geom of {body or 'world'}"
