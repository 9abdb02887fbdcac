"""Calibration procedures on live devices, with prompts for the user's caliper or load cell
readings.

On the emulated rig the emulated world provides the caliper and load cell readings. These
instruments are outside the device; on a real rig a person reads them.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjtactile.calibrate.camera import BoardView, Finder
from mjtactile.calibrate.valve import ValveCalibration, calibrate_valve
from mjtactile.core import scaled_clock
from mjtactile.core.errors import DeviceError, InputError
from mjtactile.core.types import Array, Command, Image
from mjtactile.devices.camera.opencv import OpenCvCamera
from mjtactile.devices.dynamixel.gripper import DynamixelGripper
from mjtactile.devices.valve.driver import BoardValve
from mjtactile.rig.finger import Rig
from mjtactile.runtime.references import settled_images, take_references

Notify = Callable[[str], None]
Ask = Callable[[str], float | None]
"""Function that asks the user for a number; None: skip this value."""

# a view is used if the board is still, at a new pose
_STILL_PX = 2.0
_NEW_VIEW_FRACTION = 0.06
_SPEED = 0.010  # speed of the opening while calibrating, m/s
_PERIOD = 0.02  # time between two commands, s
_REST_TIME = 0.6  # settling time at each opening, s
# stall detection: time without motion, s; time limit for reaching the object, s
_STALL_TIME = 0.5
_CLOSE_TIME_MAX = 20.0
# stall detection: motion threshold of the opening, m; lead of the goal over the jaws, m
_STILL = 1e-4
_AHEAD_MIN = 8e-3
_AHEAD_MAX = 30e-3
_VALVE_STAGES = (1.0, 2.0, 1.0)  # durations of venting, step, venting again, s
_SAMPLE = 0.01  # time between pressure samples, s


# -- camera
# --------------------------------------------------------------------------------


def collect_views(
    snapshots: Iterator[tuple[str, NDArray[np.uint8]]], finder: Finder, count: int, notify: Notify
) -> list[BoardView]:
    """Collect `count` views of a board that the user moves.

    A view is taken when the board rests at a new position. Fewer views are returned if the images
    end.
    """
    taken: list[BoardView] = []
    before: BoardView | None = None
    for name, gray in snapshots:
        view = finder.find(name, gray)
        if (
            view is not None
            and before is not None
            and _largest_movement(view, before) < _STILL_PX
            and all(
                _largest_movement(view, other) > _NEW_VIEW_FRACTION * gray.shape[1]
                for other in taken
            )
        ):
            taken.append(view)
            notify(
                f"view {len(taken)} of {count}: {len(view.ids)} corners. {_hint(taken, gray.shape)}"
            )
            if len(taken) == count:
                break
        before = view
    return taken


def camera_images(camera: OpenCvCamera, seconds: float) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Yield each new image of a camera for `seconds` s. Raises DeviceError if the camera fails."""
    end = scaled_clock.monotonic() + seconds
    last = 0.0
    index = 0
    while scaled_clock.monotonic() < end:
        if camera.wait_newer(last, 0.5):
            image = camera.read()
            last = image.time
            index = index + 1
            yield f"picture {index}", image.pixels


def _largest_movement(view: BoardView, other: BoardView) -> float:
    """Return the largest movement, px, of the corners common to both views; infinite without
    any."""
    shared, a, b = np.intersect1d(view.ids, other.ids, return_indices=True)
    if len(shared):
        return float(np.max(np.linalg.norm(view.uv[a] - other.uv[b], axis=1)))
    return np.inf


def _hint(taken: Sequence[BoardView], shape: tuple[int, ...]) -> str:
    """Name an image corner without detected board corners, as a hint to the user."""
    uv = np.concatenate([view.uv for view in taken])
    names = np.array([["upper left", "upper right"], ["lower left", "lower right"]])
    quarter = np.histogram2d(
        uv[:, 1] / shape[0], uv[:, 0] / shape[1], bins=4, range=((0, 1), (0, 1))
    )[0]
    empty = [str(names[i, j]) for i in (0, 1) for j in (0, 1) if quarter[3 * i, 3 * j] == 0]
    if empty:
        return f"Move the tilted board to the {empty[0]}."
    return "Tilt the board in another direction, or move it closer."


# -- frame and force
# --------------------------------------------------------------------------------


def reference_images(
    rig: Rig, notify: Notify
) -> list[tuple[list[Image], list[Image], float | None]]:
    """Take images of each finger's flat and inflated membrane, with the pressure sensor's reading,
    Pa."""
    taken = {}
    for reference in take_references(rig.fingers, rig.clock, notify):
        taken[reference.stage] = reference
    pressures = taken["rest"].gauge_pressure or [None] * len(rig.fingers)
    return list(zip(taken["flat"].images, taken["rest"].images, pressures, strict=True))


def dropped_images(
    rig: Rig, forces: Sequence[float], load_cell: Ask, notify: Notify
) -> Iterator[tuple[str, float, list[list[Image]]]]:
    """Squeeze a load cell with rising force limits, N, and yield its readings and images of each
    finger.

    Each item is a name, the load cell's reading, N, and the images. The jaws open again at the end.
    The load cell's support carries a constant part of each force, but none without load.
    """
    gripper: Any = rig.gripper
    for force in sorted(forces):
        notify(f"squeezing with a force limit of {force:.2f} N")
        _squeeze(gripper, force)
        with keepalive(gripper):
            shots = settled_images(rig.fingers, rig.clock)
            measured = load_cell(f"load cell reading, N (force limit {force:.2f})")
        if measured is not None:
            yield f"{force:.2f} N", measured, shots
    _move(gripper, min(gripper.state().opening + 0.02, gripper.config.opening[1]), max(forces))


# -- gripper
# --------------------------------------------------------------------------------


def measure_openings(
    gripper: DynamixelGripper, openings: Sequence[float], ask: Ask, force: float, notify: Notify
) -> tuple[Array, list[str], Array]:
    """Reach each opening, m, from both sides, and request the caliper's reading.

    Returns:
        Reported openings, m, directions, and measured openings, m.
    """
    rows: list[tuple[float, str, float]] = []
    path = [
        *((o, "closing") for o in sorted(openings, reverse=True)),
        *((o, "opening") for o in sorted(openings)),
    ]
    low, high = gripper.config.opening
    for opening, direction in path:
        away = 4e-3 if direction == "closing" else -4e-3
        notify(f"moving to {1e3 * opening:.1f} mm, {direction}")
        _move(gripper, min(max(opening + away, low), high), force)
        _move(gripper, opening, force)
        reported = gripper.state().opening
        with keepalive(gripper):
            measured = ask(
                "caliper reading between the sensors' frames, mm (jaws report "
                f"{1e3 * reported:.2f})"
            )
        if measured is not None:
            rows.append((reported, direction, 1e-3 * measured))
    reported_all, directions, measured_all = zip(*rows, strict=True) if rows else ((), (), ())
    return np.array(reported_all), list(directions), np.array(measured_all)


def measure_forces(
    gripper: DynamixelGripper, forces: Sequence[float], ask: Ask, notify: Notify
) -> tuple[Array, Array]:
    """Squeeze the object between the jaws with rising force limits, N. Return the reported forces
    and the load cell readings, N."""
    rows = []
    for force in sorted(forces):
        notify(f"squeezing with a force limit of {force:.2f} N")
        _squeeze(gripper, force)
        reported = float(np.mean([_pause(gripper, _PERIOD).effort for _ in range(10)]))
        with keepalive(gripper):
            measured = ask(f"load cell reading, N (currents report {reported:.2f})")
        if measured is not None:
            rows.append((reported, measured))
    _move(gripper, min(gripper.state().opening + 0.01, gripper.config.opening[1]), max(forces))
    reported_all, measured_all = zip(*rows, strict=True) if rows else ((), ())
    return np.array(reported_all), np.array(measured_all)


def _pause(gripper: DynamixelGripper, seconds: float):
    scaled_clock.sleep(seconds)
    return gripper.state()


@contextlib.contextmanager
def keepalive(*devices: Any) -> Iterator[None]:
    """Poll grippers or valves while the user reads an instrument or images are processed.

    Without polling, the servos' watchdog or the valve board's heartbeat would treat the host as
    hung.
    """
    done = scaled_clock.Event()

    def call() -> None:
        while not done.wait(0.05):
            for device in devices:
                with contextlib.suppress(DeviceError):
                    device.state()

    thread = threading.Thread(target=call, name="keep alive", daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def _move(gripper: DynamixelGripper, opening: float, force: float) -> None:
    """Move slowly to an opening, m, and wait until the jaws are at rest."""
    at = gripper.state().opening
    while abs(opening - at) > 1e-9:
        at += float(np.clip(opening - at, -_SPEED * _PERIOD, _SPEED * _PERIOD))
        gripper.command(Command(at, force))
        _pause(gripper, _PERIOD)
    for _ in range(round(_REST_TIME / _PERIOD)):
        gripper.command(Command(opening, force))
        _pause(gripper, _PERIOD)


def _squeeze(gripper: DynamixelGripper, force: float) -> None:
    """Close until the jaws have been at rest for _STALL_TIME. Raises DeviceError if no object is
    between them."""
    low = gripper.config.opening[0]
    start = still_since = scaled_clock.monotonic()
    goal = stood = gripper.state().opening
    while scaled_clock.monotonic() - still_since < _STALL_TIME:
        opening = gripper.state().opening
        # The goal runs ahead of the jaws, far enough that the servo requests all the force it may
        # use.
        goal = max(low, goal - _SPEED * _PERIOD, opening - _AHEAD_MAX)
        gripper.command(Command(goal, force))
        _pause(gripper, _PERIOD)
        if abs(opening - stood) > _STILL or opening - goal < _AHEAD_MIN:
            stood = opening
            still_since = scaled_clock.monotonic()
        if opening <= low + 1e-4 or scaled_clock.monotonic() - start > _CLOSE_TIME_MAX:
            raise DeviceError(
                "the jaws closed without contact: put the load cell between them, or use "
                "`--forces FILE.csv`"
            )


# -- valve
# --------------------------------------------------------------------------------


def step_valve(
    valve: BoardValve, pressure: float, seal_time: float, notify: Notify
) -> tuple[Array, Array, list[str]]:
    """Vent, open at `pressure` Pa, seal for `seal_time` s, and vent.

    Returns:
        Times, s, gauge pressures, Pa, and stages.

    Raises InputError for a board without a pressure sensor, DeviceError when it does not respond.
    """
    rows: list[tuple[float, float, str]] = []
    vent, rise, fall = _VALVE_STAGES

    def seal() -> None:  # also for a valve that did not move; the evaluation reports it
        valve.board.seal(valve.config.channel)

    for stage, act, seconds in (
        ("vent", lambda: valve.open(0.0), vent),
        ("open", lambda: valve.open(pressure), rise),
        ("closed", seal, seal_time),
        ("vent", lambda: valve.open(0.0), fall),
    ):
        notify(f"{valve.config.finger}: {stage} for {seconds:g} s")
        if not rows:
            act()
            scaled_clock.sleep(vent)  # the initial vent must not appear as a step in the samples
        act()
        end = scaled_clock.monotonic() + seconds
        while (now := scaled_clock.monotonic()) < end:
            reading = valve.board.measure(valve.config.channel)
            if reading.gauge_pressure is None:
                message = "the board has no pressure sensor, so the valve cannot be calibrated"
                raise InputError(message, field=f"valve.{valve.config.finger}")
            if not rows or reading.time > rows[-1][0]:
                rows.append((reading.time, reading.gauge_pressure, stage))
            scaled_clock.sleep(max(0.0, now + _SAMPLE - scaled_clock.monotonic()))
    times, pressures, stages = zip(*rows, strict=True)
    return np.array(times), np.array(pressures), list(stages)


def calibrate_live_valve(
    valve: BoardValve, pressure: float, seal_time: float, notify: Notify
) -> ValveCalibration:
    """Run `step_valve` and evaluate its samples."""
    return calibrate_valve(*step_valve(valve, pressure, seal_time, notify), pressure)
