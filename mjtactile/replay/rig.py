"""Rig that replays a recording: the same images, states and times, at maximum speed.

Nothing reacts to commands: the answer to each command is the one that was sent in the recording.
The same controller and code therefore reproduce the results bit for bit. Another controller shows
the commands that it would have requested.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain

from mjtactile.core.calibration import calibration_from_table
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import DeviceError, InputError
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import COMMAND_FIELDS, Command, GripperState, Image, ValveState
from mjtactile.recording.reader import Recording, load_recording
from mjtactile.recording.recorded_sensors import recorded_sensors
from mjtactile.rig.command_limits import UNLIMITED
from mjtactile.rig.finger import Rig, make_fingers
from mjtactile.rig.registry import RigRequest


class Tape:
    """Position of a replay: first the reference images, then cycle by cycle."""

    def __init__(self, recording: Recording):
        self.recording = recording
        self.cycle = -1
        self.ended = False
        self._references = [
            _reference_images(recording, finger) for finger in range(recording.width)
        ]
        self._frames = recording.images()
        self._now: tuple[Image, ...] = ()

    def read(self, camera: int) -> Image:
        """Return the next image of one camera. The first camera starts a cycle. Raises the recorded
        DeviceError."""
        image = next(self._references[camera], None)
        if image is not None:
            return image
        if camera == 0:
            self._advance()
        return self._now[camera]

    def value(self, key: str) -> float:
        """Return a value of the current cycle; NaN if an older recording lacks it."""
        column = self.recording.columns.get(key)
        return math.nan if column is None else float(column[self.cycle])

    def _advance(self) -> None:
        images = None if self.ended else next(self._frames, None)
        if images is None:
            self.ended = True
            raise DeviceError("the recording has ended")
        before = self._now
        self._now = images
        self.cycle += 1
        status = self.recording.columns["status"][self.cycle]
        repeated = before and all(a.time == b.time for a, b in zip(before, images, strict=True))
        if repeated and all(text != "ok" for text in status):  # a cycle in which the loop was blind
            raise DeviceError(str(status[0]))


class ReplayClock:
    """The recorded times. Raises DeviceError when the recording has ended."""

    def __init__(self, tape: Tape):
        self._tape = tape

    def now(self) -> float:
        if self._tape.ended:
            raise DeviceError(
                f"{self._tape.recording.folder}: the recording ends after "
                f"{len(self._tape.recording)} cycles"
            )
        return float(self._tape.recording.columns["time"][max(self._tape.cycle, 0)])

    def advance_towards(self, time: float) -> None:
        """Do nothing: only the recording advances."""

    def wait_until(self, time: float) -> None:
        """Return at once: a replay runs as fast as possible."""


class ReplayCamera:
    """One camera's recorded images."""

    def __init__(self, tape: Tape, camera: int):
        self._tape = tape
        self._camera = camera

    def read(self) -> Image:
        return self._tape.read(self._camera)


class ReplayGripper:
    """Gripper with recorded states, which answers a command with the recorded one."""

    def __init__(self, tape: Tape):
        self._tape = tape

    def request_state(self) -> None:
        """Do nothing: the recording contains the answer."""

    def state(self) -> GripperState:
        tape = self._tape
        notes = self._tape.recording.notes
        if tape.cycle < 0:
            return GripperState(
                float(notes["start_opening"]), 0.0, 0.0, float(notes["start_lift_height"])
            )
        opening = tape.value("opening")
        if math.isnan(opening):  # it had failed
            raise DeviceError(str(tape.recording.columns["reason"][tape.cycle]))
        return GripperState(
            opening,
            tape.value("speed"),
            tape.value("effort"),
            tape.value("lift_height"),
            tape.value("gripper_time"),
            tape.value("gripper_age"),
        )

    def command(self, command: Command) -> Command:
        """Return the recorded goals, with phase, memory and reason of `command`."""
        sent = self._tape.recording.command(self._tape.cycle)
        goals = {name: getattr(sent, name) for name, field in COMMAND_FIELDS.items() if field.limit}
        return replace(command, **goals)


class ReplayValve:
    """Recorded valve states; opening and closing does nothing."""

    def __init__(self, tape: Tape, finger: int):
        self._tape = tape
        self._finger = finger

    def state(self) -> ValveState:
        recording = self._tape.recording
        if self._tape.cycle < 0:
            return ValveState(
                False, _pressure(recording.references[-1].gauge_pressure[self._finger])
            )
        return recording.valves(self._tape.cycle)[self._finger]

    def open(self, supply_gauge: float) -> None:
        """Ignore the command: the recording fixes the valve's state."""

    def close(self) -> None:
        """Ignore the command: the recording fixes the valve's state."""

    def regulate_pressure(self, gauge_pressure: float | None) -> None:
        """Do nothing: the valve followed the recorded command."""


def build_replay_rig(folder: str, requested: str | SensorDesign | None = None) -> Rig:
    """Build a rig from the recording in `folder`, with the sensors that it contains.

    Args:
        folder: Folder of the recording, or of the run that contains it.
        requested: Requested sensor; None: any.

    Raises:
        InputError: The recording cannot be replayed, or has another sensor than `requested`.
    """
    recording = load_recording(folder)
    _require_replayable(recording, folder)
    tape = Tape(recording)
    width = recording.width
    count = recording.valve_count
    cameras = tuple(ReplayCamera(tape, i) for i in range(width))
    valves = tuple(ReplayValve(tape, i) for i in range(count))
    limits = UNLIMITED if count == width else replace(UNLIMITED, pressure=None)
    tables = recording.notes.get("calibration", {})
    calibrations = tuple(
        calibration_from_table(tables[name], folder) if name in tables else None
        for name in recording.fingers
    )
    designs = tuple(recorded_sensors(recording, requested).values())
    return Rig(
        name="replay",
        fingers=make_fingers(recording.fingers, designs, cameras, valves, calibrations),
        gripper=ReplayGripper(tape),
        clock=ReplayClock(tape),
        limits=limits,
        close=lambda: None,
        length=float(recording.columns["time"][-1] - recording.columns["time"][0]),
        simulated=recording.notes.get("simulated", {}),
        recorded=recording.facts(),
        flags=lambda: recording.flags,
    )


def _require_replayable(recording: Recording, folder: str) -> None:
    """Raise InputError for an incomplete recording."""
    starts = [recording.notes.get(key) for key in ("start_opening", "start_lift_height")]
    recording.require_images()
    if not len(recording) or None in starts or len(recording.references) != 2:
        raise InputError(
            "cannot be replayed: it has no cycles or no reference images", source=folder
        )


def build(request: RigRequest) -> Rig:
    """Build the rig of the backend "replay" of `mjtactile.rig.registry`."""
    requested = request.scenario.sensor
    return build_replay_rig(request.argument, None if requested == Scenario().sensor else requested)


def _reference_images(recording: Recording, finger: int) -> Iterator[Image]:
    return chain.from_iterable(reference.images(finger) for reference in recording.references)


def _pressure(value: object) -> float | None:
    return None if value is None or value != value else float(value)  # type: ignore[arg-type]
