"""What was recorded, as patches: grips of any rig of two fingers, and presses of one sensor on a
stage."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.calibration import calibration_from_table, pressure_reading
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Array
from mjtactile.explore.grip_scan import GripCycle, grips_of, patches_of_grip
from mjtactile.explore.patch_from_touch import Pressed, patch_from_press
from mjtactile.explore.surface_patch import Patch
from mjtactile.recording.reader import Recording
from mjtactile.recording.stage_protocol import Move, stage_from_note
from mjtactile.rig.registry import build_rig
from mjtactile.runtime.session import Session
from mjtactile.sensing.stateful_pipeline import StatefulPipeline

_SEEN = 0.08  # N, from which on images tell of the body
_MOST = 8  # images of a press, its whole way
_LIFTED = 3e-3  # m above where it goes to, that a lifted indenter comes from


def patches_of_recording(recording: Recording, group: int, yaw: float = 0.0) -> list[Patch]:
    """What a recording says of a surface: the grips of two fingers (`probe`, `grasp` or `explore
    --out`, a real rig's `record`), or presses on a stage (`record --steps`).

    Args:
        recording: With its images and its references.
        group: A number that no other grip has, nor the numbers after it.
        yaw: rad by which the object was turned about z against its own frame.

    Returns:
        A patch for each finger of each grip, in the object's frame: its origin is the place between
        the fingers, where the hand began. Of presses one patch, in the frame of the stage: its
        origin is the place of the indenter that touched first, its axes are the sensor's.

    Raises:
        InputError: Where images or references are missing, or it is neither.
    """
    recording.require_images()
    stages = {reference.stage for reference in recording.references}
    if not {"flat", "rest"} <= stages:
        raise InputError("has no reference images (flat and rest)", source=recording.folder)
    if "stage" in recording.notes:
        return _of_presses(recording)
    sensor = str(recording.header.get("sensor", "dense"))
    rig = build_rig(Scenario(rig=f"replay:{recording.folder}", sensor=sensor))
    session = Session(rig)
    session.take_references()
    moments = _re_estimate(recording, session)
    if len(rig.fingers) != 2 or not any(math.isfinite(one.opening) for one in moments):
        raise InputError(
            "is neither a grip of two fingers nor a press on a stage", source=recording.folder
        )
    designs = [finger.design for finger in rig.fingers]
    patches = []
    for number, grip in enumerate(grips_of(moments), group):
        patches += patches_of_grip(grip, session.perceptions, designs, yaw=yaw, group=number)
    return patches


def _re_estimate(recording: Recording, session: Session) -> list[GripCycle]:
    """What every cycle's images say, with where the jaws and the hand were."""
    moments = []
    for cycle, images in enumerate(recording.images()):
        now = float(recording.column("time")[cycle, 0])
        readings = [pressure_reading(valve) for valve in recording.valves(cycle)]
        readings += [None] * (len(images) - len(readings))
        touch = tuple(
            chain.perceive(image, now, reading)
            for chain, image, reading in zip(session.perceptions, images, readings, strict=True)
        )
        opening = float(recording.column("opening")[cycle, 0])
        height = float(recording.column("lift_height")[cycle, 0])
        moments.append(GripCycle(touch, opening, height))
    return moments


def _of_presses(recording: Recording) -> list[Patch]:
    """The way of the stage to its firmest hold, as one press."""
    stage = stage_from_note(recording.notes["stage"], recording.folder)
    fingers = recording.fingers
    finger = fingers.index(recording.notes["stage"].get("finger", fingers[0]))
    design = load_sensor(str(recording.header.get("sensor", "dense")))
    perception = _zeroed(recording, finger, design)
    assert perception.state.reference is not None
    times = recording.column("time")[:, 0]
    depths, shears = _driven(stage.moves, times - times[0])
    seen = [
        perception.perceive(images[finger], float(time))
        for time, images in zip(times, recording.images(), strict=True)
    ]
    forces = np.array([touch.force_normal for touch in seen])
    felt = np.where(np.isfinite(forces) & np.isfinite(depths), forces, 0.0)
    if not len(felt) or felt.max() < _SEEN:
        return []
    way = _direction_to_stiffest(felt)
    rest = perception.state.reference.surface
    row = int(np.abs(rest.y - stage.at[1]).argmin())
    column = int(np.abs(rest.x - stage.at[0]).argmin())
    top = float(rest.z[row, column]) + design.membrane.thickness / 2
    p_SH = np.column_stack(
        [stage.at[0] + shears[way], np.full(len(way), stage.at[1]), top - depths[way]]
    )
    touches = tuple(seen[cycle] for cycle in way)
    pressed = Pressed(touches, np.eye(3), p_SH, perception.shape(touches))
    patch = patch_from_press(pressed, design)
    return [] if patch is None else [patch]


def _direction_to_stiffest(felt: Array) -> NDArray[np.int64]:
    """Cycles from where something is felt for good to the firmest hold, at most `_MOST` and that
    one, of the forces `felt` (k,) N."""
    firmest = int(felt.argmax())
    quiet = np.flatnonzero(felt[:firmest] < _SEEN)
    begin = quiet[-1] + 1 if len(quiet) else 0
    way = np.arange(begin, firmest + 1)
    if len(way) > _MOST:
        every = math.ceil(len(way) / _MOST)
        way = way[::every]
    if way[-1] != firmest:
        way = np.append(way, firmest)
    return way


def _zeroed(recording: Recording, finger: int, design: SensorDesign) -> StatefulPipeline:
    """A chain with the references of one recorded finger."""
    tables = recording.notes.get("calibration", {})
    name = recording.fingers[finger]
    calibration = None
    if name in tables:
        calibration = calibration_from_table(tables[name], str(recording.folder))
    perception = StatefulPipeline.of(design, calibration)
    flat, rest = recording.references
    perception.measure_flat_reference(list(flat.images(finger)))
    gauge = rest.gauge_pressure[finger] if finger < len(rest.gauge_pressure) else None
    if gauge is None or math.isnan(gauge):
        gauge = design.chamber.supply_gauge
    elif calibration is not None:
        gauge = calibration.pressure(gauge)
    perception.measure_rest_reference(list(rest.images(finger)), gauge)
    return perception


def _driven(moves: tuple[Move, ...], times: Array) -> tuple[Array, Array]:
    """Depths, m below first touch, and shears, m, of a stage at some times, s; NaN where it is
    lifted off, or loaded with a weight."""
    depths = np.full(len(times), np.nan)
    shears = np.zeros(len(times))
    depth = math.nan
    shear = 0.0
    for move in moves:
        later = times >= move.time
        start = depth if math.isfinite(depth) else move.depth - _LIFTED
        way = max(abs(move.depth - start), abs(move.shear - shear), 1e-9)
        share = np.clip((times[later] - move.time) * move.speed / way, 0.0, 1.0)
        depths[later] = start + share * (move.depth - start)
        shears[later] = shear + share * (move.shear - shear)
        depth = move.depth
        shear = move.shear
    return depths, shears
