"""Checks of `mjtactile doctor` on a simulated rig: names, fingers, jaw motion and lift motion."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial

import mujoco
import numpy as np

from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError, SimulationError
from mjtactile.core.types import Array
from mjtactile.rig.doctor_finding import Finding
from mjtactile.rig.simulated import SimRigFile
from mjtactile.sim.attach import configure_options
from mjtactile.sim.scenes.grasp_world import finger_designs
from mjtactile.sim.scenes.gripper_world import GripperWorld
from mjtactile.sim.scenes.initial_state import arm_actuators, arm_joints, missing_names
from mjtactile.sim.scenes.mjcf import read_mjcf
from mjtactile.sim.scenes.world import touched_by_sensors
from mjtactile.sim.sensor import carrier_geoms

_ABOVE_TABLE = 5e-3  # height of the sensors' frames over the table in the test, m
# limit between a site's z and the direction to the center of the fingertips
_INWARD = math.cos(math.radians(60))
_ASKEW = math.cos(math.radians(10))
_LEANING = math.sin(math.radians(5))  # maximum angle of a site's z from the horizontal
_Y_MAX = 20.0  # maximum angle between y of two sites, degrees
_UNEVEN = 2e-3  # tolerance of the height difference between fingertips, m
_OPENING_WRONG = 1e-3  # tolerance of the opening law against the fingertip positions, m
_MOVES = 1e-3  # minimum fingertip motion, m
_HEIGHT_WRONG = 2e-3  # tolerance of the lift height, m
_FORCE_MIN = 1.0  # minimum force on each finger, N; the shipped controllers hold with 0.6
_WIDTHS = (0.2, 0.6)  # fractions of the opening range of narrow and wide objects
_EVEN = 0.01  # relative difference of equal forces
_SLACK = 1.5  # factor on the time of a motion at the rig's speed
_IN_THE_WAY = "move the site, or set contype and conaffinity of that geom to 0"
_TOO_LOW = (
    "the fingertips are too low there: raise the sites, limit opening_min_mm and opening_max_mm, "
    "or correct table_height_mm"
)
_ok, _warn, _bad = (partial(Finding, level) for level in ("ok", "warn", "bad"))


def examine_simulated(rig: SimRigFile, sensor: str = "dense") -> list[Finding]:
    """Return all findings; `sensor` is on fingers without one. Raises InputError."""
    return list(_findings(rig, finger_designs(rig, load_sensor(sensor))))


def _findings(rig: SimRigFile, designs: Sequence[SensorDesign]) -> Iterator[Finding]:
    try:
        spec = read_mjcf(rig.model)
    except InputError as error:
        yield _bad("model", str(error), "correct the MJCF; `python -m mujoco.viewer` shows it")
        return
    missing = list(missing_names(spec, rig))
    for error in missing:
        text = str(error).split(": ", 2)[-1]
        yield _bad(error.field or "name", text, "correct the name in the rig file")
    if missing:
        return
    yield _ok("names", "all sites, actuators and bodies exist")
    yield _options(spec)
    half_height = max(max(d.frame.length, d.frame.width) / 2 + d.frame.rim for d in designs)
    try:
        world = GripperWorld(rig, designs, half_height + _ABOVE_TABLE)
    except InputError as error:
        remedy = "correct this first; it prevents all further checks"
        yield _bad(error.field or "rig", str(error), remedy)
        return
    yield from [*_fingers(world), *_frames(world), *_carriers(world), *_arm(world)]
    try:
        yield from [*_motions(world), *_force(world)]
    except SimulationError as error:
        remedy = "correct the rig: it does not stay at rest without commands"
        yield _bad("simulation", str(error), remedy)


def _options(spec: mujoco.MjSpec) -> Finding:
    changed = [change.split(" (")[0] for change in configure_options(spec)]
    text = "are those that the sensors require"
    if changed:
        text = f"the sensors require other values, which are set: {', '.join(changed)}"
    return _ok("options", text)


def _fingers(world: GripperWorld) -> Iterator[Finding]:
    """Check each fingertip's site: direction toward the other fingertips, and height."""
    p_WS, z_W = _tips(world)
    centre = p_WS.mean(axis=0)
    for finger, position, inward in zip(world.rig.fingers, p_WS, z_W, strict=True):
        subject = f"finger {finger.name}"
        away = centre - position
        cosine = float(away @ inward / max(np.linalg.norm(away), 1e-9)) if len(p_WS) > 1 else 1.0
        angle = math.degrees(math.acos(max(-1.0, min(1.0, cosine))))
        if cosine < _INWARD:
            yield _bad(
                subject,
                f"z of site {finger.site!r} points {angle:.0f} degrees away from the center "
                "of the fingertips",
                "rotate the site: its z points out of the sensor, towards the object",
            )
        elif cosine < _ASKEW:
            yield _warn(
                subject,
                f"z of site {finger.site!r} misses the center of the fingertips by "
                f"{angle:.0f} degrees",
                "the sensor touches with an edge first; rotate or move the site",
            )
        elif abs(inward[2]) > _LEANING:
            yield _warn(
                subject,
                f"is tilted by {math.degrees(math.asin(abs(inward[2]))):.0f} degrees from the "
                "vertical",
                "the sensor touches with an edge first; choose another keyframe, or rotate "
                "the site",
            )
        elif abs(away[2]) > _UNEVEN:
            yield _warn(
                subject,
                f"is {1e3 * abs(away[2]):.1f} mm {'below' if away[2] > 0 else 'above'} the "
                "center of the fingertips",
                "an object tilts when it is gripped; move the site",
            )
        else:
            yield _ok(subject, f"site {finger.site!r} faces the center of the fingertips")


def _frames(world: GripperWorld) -> Iterator[Finding]:
    """Check that y of two fingers has one direction, which loads from their shears require."""
    if len(world.sensors) != 2:
        return
    first, second = (
        world.data.xmat[sensor.body_id].reshape(3, 3)[:, 1] for sensor in world.sensors
    )
    angle = math.degrees(math.acos(max(-1.0, min(1.0, float(first @ second)))))
    if angle > _Y_MAX:
        names = " and ".join(repr(finger.site) for finger in world.rig.fingers)
        yield _warn(
            "frames",
            f"y of the sites {names} differs by {angle:.0f} degrees",
            "rotate a site about its z: 'adaptive' takes internal forces for load otherwise",
        )


def _arm(world: GripperWorld) -> Iterator[Finding]:
    """Check that an actuator holds every joint between the world and the gripper."""
    model = world.model
    rig = world.rig
    if rig.lift.kind != "arm":
        return
    held = arm_actuators(model, world.start.gripper, rig)
    moved = {int(model.actuator_trnid[model.actuator(name).id, 0]) for name in held}
    loose = [
        model.joint(joint).name
        for joint in arm_joints(model, world.start.gripper)
        if joint not in moved
    ]
    yield _ok(
        "arm",
        f"{len(held)} servos reach the full {1e3 * rig.lift.travel:.0f} mm: {', '.join(held)}",
    )
    if loose:
        yield _warn(
            "arm",
            f"nothing holds {', '.join(map(repr, loose))}",
            "give these joints position actuators, name their actuators in lift.actuators, "
            "or remove them",
        )


def _motions(world: GripperWorld) -> Iterator[Finding]:
    """Inflate; then open, close and lift, and compare requested with measured fingertip motion."""
    rig = world.rig
    low, high = world.rig.gripper.opening
    if touching := touched_by_sensors(world):
        yield from _touches(
            world, {"at its start": touching}
        )  # no measurement is possible from there
        return
    for sensor in world.sensors:
        sensor.open_valve()
    _wait(world, 0.3)
    for sensor in world.sensors:
        sensor.close_valve()
    touched = {"when it is inflated": touched_by_sensors(world)}
    sag = -world.lift_height
    reached: dict[float, tuple[float, float]] = {}
    for goal, where in ((high, "opened"), (low, "closed")):
        world.set_finger_target(goal, rig.gripper.force_max)
        _wait(world, _SLACK * abs(goal - world.opening) / rig.gripper.speed + 0.3)
        touched[f"when it is {where}"] = touched_by_sensors(world)
        reached[goal] = world.opening, _opening_seen(world)
    yield from _jaws(reached, low, high)
    yield from _touches(world, touched)
    world.set_finger_target(rig.gripper.start)
    yield from _lift(world, sag)


def _jaws(reached: dict[float, tuple[float, float]], low: float, high: float) -> Iterator[Finding]:
    opened, response_open = reached[high]
    closed, response_closed = reached[low]
    travel = f"from {_mm(response_open)} to {_mm(response_closed)} mm"
    if response_open - response_closed < -_MOVES:
        yield _bad(
            "jaws",
            f"move in the wrong direction: on a command to close, the fingertips move {travel}",
            "reverse the sign of mm_per_rad or mm_per_mm, or the order of the table",
        )
        return
    if response_open - response_closed < _MOVES:
        yield _bad(
            "jaws",
            f"do not move: on a command to close, the fingertips move {travel}",
            "check that it is the right actuator, that its force suffices and that nothing jams",
        )
        return
    wrong = max(abs(opened - response_open), abs(closed - response_closed))
    if wrong > _OPENING_WRONG:
        yield _warn(
            "jaws",
            f"do not follow the transmission: it gives {_mm(opened)} to {_mm(closed)} mm, the "
            f"sites move {travel}",
            "correct transmission, mm_per_rad or mm_per_mm, or jaw_offset_mm",
        )
    elif max(abs(opened - high), abs(closed - low)) > _OPENING_WRONG:
        yield _warn(
            "jaws",
            f"reach {_mm(closed)} to {_mm(opened)} mm, not {_mm(low)} to {_mm(high)} mm",
            "set opening_min_mm and opening_max_mm to the reached values",
        )
    else:
        yield _ok(
            "jaws",
            f"open and close, {travel}; transmission and sites agree within {1e3 * wrong:.2f} mm",
        )


def _touches(
    world: GripperWorld, touched: dict[str, set[tuple[str, str, str]]]
) -> Iterator[Finding]:
    found = {
        (prefix, body, geom): where
        for where, touches in reversed(touched.items())
        for prefix, body, geom in touches
    }
    for (prefix, body, geom), where in found.items():
        yield _bad(
            f"finger {prefix.rstrip('/')}",
            f"its sensor touches {geom!r} {where}",
            _TOO_LOW if _is_fixed(world, body) else _IN_THE_WAY,
        )
    if not found:
        yield _ok("sensors", "touch nothing when inflated, opened or closed")


def _is_fixed(world: GripperWorld, body: str) -> bool:
    """Return True for a body of the scene that does not move, such as the table."""
    return body != "" and int(world.model.body_weldid[world.model.body(body).id]) == 0


def _carriers(world: GripperWorld) -> Iterator[Finding]:
    """Report geoms of the fingers that objects press through the membrane."""
    for finger, sensor in zip(world.rig.fingers, world.sensors, strict=True):
        geoms = carrier_geoms.carrier_geoms(world.model, world.data, sensor)
        if len(geoms):
            names = carrier_geoms.names_of(world.model, geoms)
            yield _warn(
                f"finger {finger.name}",
                f"objects can rest on {names} instead of the membrane of its sensor",
                carrier_geoms.remedy(sensor),
            )


def _lift(world: GripperWorld, sag: float) -> Iterator[Finding]:
    """Check the lift over its whole travel."""
    lift = world.rig.lift
    if lift.kind == "none":
        yield _warn("lift", "does not exist: a grasped object stays on the table")
        return
    world.set_lift_target(lift.travel)
    _wait(world, _SLACK * lift.travel / lift.speed + 0.5)
    risen = world.lift_height
    if abs(risen - lift.travel) > _HEIGHT_WRONG:
        yield _bad(
            "lift",
            f"commanded {1e3 * lift.travel:.0f} mm, the gripper rose by {1e3 * risen:.1f} mm",
            "reduce travel_mm, or use stiffer and stronger servos",
        )
    elif abs(sag) > 0.5 * _HEIGHT_WRONG:
        yield _warn(
            "lift",
            f"the gripper sank by {1e3 * sag:.1f} mm at the start",
            'use stiffer servos, or gravcomp="1"',
        )
    else:
        yield _ok(
            "lift",
            f"{lift.kind}: the gripper rose by {1e3 * risen:.1f} of {1e3 * lift.travel:.0f} mm",
        )


def _force(world: GripperWorld) -> Iterator[Finding]:
    """Compare `force_max_N` with the force of the actuators at the widths of objects."""
    requested = world.rig.gripper.force_max
    widths = _object_widths(world)
    forces = [world.grip_force_available(width) for width in widths]
    pairs = zip(forces, widths, strict=True)
    at = [f"{force:.2g} N at {1e3 * width:.0f} mm" for force, width in pairs]
    if max(forces) - min(forces) < _EVEN * max(forces):  # limited by the force range
        text = f"the actuators close each finger with at most {min(forces):.2g} N"
        remedy = "use a larger forcerange"
    else:
        text = f"the actuators close each finger with at most {' and '.join(at)}"
        remedy = "use a stiffer actuator (kp), or a ctrlrange beyond the closed jaws"
    if max(forces) < _FORCE_MIN:
        yield _bad(
            "force",
            f"{text}: too little for a grasp",
            f"{remedy}, or correct the ratio of the transmission",
        )
    elif min(forces) < (1 - _EVEN) * requested:
        yield _warn(
            "force",
            f"{text}, force_max_N says {requested:g}",
            f"{remedy}, or a smaller force_max_N",
        )
    else:
        yield _ok(
            "force",
            f"force_max_N = {requested:g} on each finger is within the range of the actuators",
        )


def _object_widths(world: GripperWorld) -> tuple[float, float]:
    """Return the narrowest and the widest object of the checks, m, within the opening range."""
    low, high = world.rig.gripper.opening
    narrow, wide = (low + fraction * (high - low) for fraction in _WIDTHS)
    return narrow, wide


def _mm(metres: float) -> str:
    return f"{round(1e3 * metres, 1) + 0.0:.1f}"  # + 0.0: no -0.0


def _wait(world: GripperWorld, seconds: float) -> None:
    world.step(max(1, round(seconds / world.timestep)))


def _tips(world: GripperWorld) -> tuple[Array, Array]:
    """Return the fingertip positions (n, 3), m, and the sensors' outward directions (n, 3), frame
    W."""
    bodies = [sensor.body_id for sensor in world.sensors]
    return world.data.xpos[bodies].copy(), world.data.xmat[bodies].reshape(-1, 3, 3)[:, :, 2].copy()


def _opening_seen(world: GripperWorld) -> float:
    """Return twice the mean distance of the fingertips from their center, m."""
    p_WS, z_W = _tips(world)
    return 2 * float(np.mean(np.sum((p_WS.mean(axis=0) - p_WS) * z_W, axis=1)))
