"""Conversion of recordings to patches: grips of a two-finger rig, and indentations on a stage."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.calibration import calibration_from_table
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.explore.grip_scan import GripCycle, grips_of, patches_of_grip
from mjtactile.explore.patch_from_touch import Pressed, patch_from_press
from mjtactile.explore.surface_patch import Patch
from mjtactile.recording.reader import Recording
from mjtactile.recording.recorded_sensors import recorded_sensors
from mjtactile.recording.stage_protocol import Move, stage_from_note
from mjtactile.runtime.re_estimation import replay_session, replay_touches, zeroed_pipeline
from mjtactile.sensing.stateful_pipeline import StatefulPipeline

_MIN_FORCE = 0.08  # minimum force for a shape estimate, N
_MAX_IMAGES = 8  # images of one indentation, over its whole path
_LIFTED = 3e-3  # start height of a lifted indenter above its goal, m


def patches_of_recording(recording: Recording, group: int, yaw: float = 0.0) -> list[Patch]:
    """Compute surface patches from a recording.

    It contains grips of two fingers (`probe`, `grasp` or `explore --out`, a real rig's `record`).
    Alternatively it contains indentations on a stage (`record --protocol`).

    Args:
        recording: Recording with images and references.
        group: Group number of the first grip; it and all larger numbers must be unused.
        yaw: Rotation of the object about z relative to its own frame, rad.

    Returns:
        A patch for each finger of each grip, in the object's frame. Its origin is the point between
        the fingers at the start of the gripper motion. For a stage, one patch in the frame of the
        stage. Its origin is the first contact point of the indenter; its axes are the sensor's.

    Raises:
        InputError: Images or references are missing, or it is neither kind of recording.
    """
    recording.require_images()
    stages = {reference.stage for reference in recording.references}
    if not {"flat", "rest"} <= stages:
        raise InputError("has no reference images (flat and rest)", source=recording.folder)
    if "stage" in recording.notes:
        return _of_presses(recording)
    session = replay_session(recording, contact_shapes=False)
    rig = session.rig
    values = (recording.column(name)[:, 0].tolist() for name in ("opening", "lift_height"))
    cycles = list(map(GripCycle, replay_touches(recording, session), *values))
    if len(rig.fingers) != 2 or not any(math.isfinite(cycle.opening) for cycle in cycles):
        raise InputError(
            "is neither a grip of two fingers nor an indentation on a stage",
            source=recording.folder,
        )
    designs = [finger.design for finger in rig.fingers]
    patches = []
    for grip_number, grip in enumerate(grips_of(cycles), group):
        patches += patches_of_grip(grip, session.perceptions, designs, yaw=yaw, group=grip_number)
    return patches


def _of_presses(recording: Recording) -> list[Patch]:
    """Compute the patch of the stage motion up to its firmest hold, as one indentation."""
    stage = stage_from_note(recording.notes["stage"], recording.folder)
    fingers = recording.fingers
    finger = fingers.index(recording.notes["stage"].get("finger", fingers[0]))
    design = recorded_sensors(recording)[fingers[finger]]
    perception = _zeroed(recording, finger, design)
    assert perception.state.reference is not None
    times = recording.column("time")[:, 0]
    depths, shears = _driven(stage.moves, times - times[0])
    seen = [
        perception.perceive(images[finger], float(time))
        for time, images in zip(times, recording.images(), strict=True)
    ]
    forces = np.array([touch.force_normal for touch in seen])
    forces = np.where(np.isfinite(forces) & np.isfinite(depths), forces, 0.0)
    if not len(forces) or forces.max() < _MIN_FORCE:
        return []
    path = _loading_cycles(forces)
    rest = perception.state.reference.surface
    row = int(np.abs(rest.y - stage.at[1]).argmin())
    column = int(np.abs(rest.x - stage.at[0]).argmin())
    top = float(rest.z[row, column]) + design.membrane.thickness / 2
    p_SH = np.column_stack(
        [stage.at[0] + shears[path], np.full(len(path), stage.at[1]), top - depths[path]]
    )
    touches = tuple(seen[cycle] for cycle in path)
    pressed = Pressed(touches, np.eye(3), p_SH, perception.shape(touches))
    patch = patch_from_press(pressed, design)
    return [] if patch is None else [patch]


def _loading_cycles(forces: Array) -> NDArray[np.int64]:
    """Return at most `_MAX_IMAGES` cycles from permanent contact on, plus that of the largest of
    the forces (k,), N."""
    last = int(forces.argmax())
    without_contact = np.flatnonzero(forces[:last] < _MIN_FORCE)
    start = without_contact[-1] + 1 if len(without_contact) else 0
    cycles = np.arange(start, last + 1)
    cycles = cycles[:: math.ceil(len(cycles) / _MAX_IMAGES)]
    return cycles if cycles[-1] == last else np.append(cycles, last)


def _zeroed(recording: Recording, finger: int, design: SensorDesign) -> StatefulPipeline:
    """Return a sensing pipeline with the references of one recorded finger."""
    tables = recording.notes.get("calibration", {})
    name = recording.fingers[finger]
    calibration = None
    if name in tables:
        calibration = calibration_from_table(tables[name], str(recording.folder))
    flat, rest = recording.references
    reading = rest.gauge_pressure[finger] if finger < len(rest.gauge_pressure) else None
    return zeroed_pipeline(
        design, calibration, list(flat.images(finger)), list(rest.images(finger)), reading
    )


def _driven(moves: tuple[Move, ...], times: Array) -> tuple[Array, Array]:
    """Return depth below first contact and shear of a stage at given times, s, both in m. The depth
    is NaN while the indenter is lifted or loaded with a weight."""
    depths = np.full(len(times), np.nan)
    shears = np.zeros(len(times))
    depth = math.nan
    shear = 0.0
    for move in moves:
        later = times >= move.time
        start = depth if math.isfinite(depth) else move.depth - _LIFTED
        distance = max(abs(move.depth - start), abs(move.shear - shear), 1e-9)
        fraction = np.clip((times[later] - move.time) * move.speed / distance, 0.0, 1.0)
        depths[later] = start + fraction * (move.depth - start)
        shears[later] = shear + fraction * (move.shear - shear)
        depth = move.depth
        shear = move.shear
    return depths, shears
