"""The control loop: image, touch, observation, controller, command, record. The same for every rig.

It sees a rig through its Protocols only, and never ground truth. `mjtactile.grasp` puts a job around it.
"""

from __future__ import annotations

import time as wall
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from mjtactile.controller import Controller
from mjtactile.errors import DeviceError
from mjtactile.rig import Rig
from mjtactile.sensing.pipeline import SensorPipeline
from mjtactile.types import Command, GripperState, Image, Observation, Touch, ValveState

REFERENCE_IMAGES = 10  # averaging ten takes the reference's noise to a third of an image's
SETTLE_TIME = 0.5  # s for the membrane to come to rest after the valve moved


@dataclass(frozen=True, eq=False)
class Cycle:
    """One turn of the loop, as it is recorded."""

    time: float
    images: tuple[Image, ...]
    touch: tuple[Touch, ...]
    gripper: GripperState
    valves: tuple[ValveState, ...]
    wanted: Command
    sent: Command
    camera_ms: float
    perception_ms: float
    controller_ms: float


def take_references(rig: Rig, pipelines: Sequence[SensorPipeline], report: Callable[[str], None] = lambda _: None) -> None:
    """Let every sensor measure itself: flat with the valve open to the air, then inflated, sealed, and touching nothing.

    Raises DeviceError when what the cameras see does not agree with the sensor file.
    """
    supply = rig.design.chamber.supply_gauge
    report("reference: flat, valve open")
    for valve in rig.valves:
        valve.open(0.0)
    for pipeline, images in zip(pipelines, _settled_images(rig), strict=True):
        pipeline.take_flat(images)
    report("reference: inflated, nothing touching")
    for valve in rig.valves:
        valve.open(supply)
    rig.clock.wait_until(rig.clock.now() + SETTLE_TIME)
    for valve in rig.valves:
        valve.close()
    for pipeline, valve, images in zip(pipelines, rig.valves, _settled_images(rig), strict=True):
        measured = valve.state().pressure_gauge
        pipeline.take_rest(images, supply if measured is None else measured)


def _settled_images(rig: Rig) -> list[list[Image]]:
    """Wait until everything is still, then return REFERENCE_IMAGES images of each camera."""
    rig.clock.wait_until(rig.clock.now() + SETTLE_TIME)
    shots: list[list[Image]] = [[] for _ in rig.cameras]
    for _ in range(REFERENCE_IMAGES):
        for camera, images in zip(rig.cameras, shots, strict=True):
            images.append(camera.read())
        rig.clock.wait_until(rig.clock.now() + rig.period)
    return shots


def run(rig: Rig, pipelines: Sequence[SensorPipeline], controller: Controller, *, time_limit: float,
        on_cycle: Callable[[Cycle], None], on_images: Callable[[], None] = lambda: None) -> Command:
    """Run the controller until it says "done" or "abort"; returns the last command sent.

    `on_images` is called when a cycle's images were taken and the world still stands at that time, `on_cycle` after
    its command was sent. Raises ControllerError, DeviceError (also when `time_limit` s
    pass), SimulationError; the caller closes the rig.
    """
    state = rig.gripper.state()
    command = Command(opening=state.opening, force_limit=0.0, lift_height=state.lift_height)
    start = rig.clock.now()
    deadline = start
    while command.phase not in ("done", "abort"):
        if rig.clock.now() - start > time_limit:
            raise DeviceError(f"controller {controller.path}: still in phase {command.phase!r} after {time_limit:g} s")
        deadline += rig.period
        command = _turn(rig, pipelines, controller, command, deadline, on_images, on_cycle)
        rig.clock.wait_until(deadline)
    return command


def _turn(rig: Rig, pipelines: Sequence[SensorPipeline], controller: Controller, last: Command, deadline: float,
          on_images: Callable[[], None], on_cycle: Callable[[Cycle], None]) -> Command:
    """One cycle from the images to the command that was sent. The world moves on meanwhile."""
    begin = wall.perf_counter()
    images = tuple(camera.read() for camera in rig.cameras)
    seen = wall.perf_counter()
    now, gripper, valves = rig.clock.now(), rig.gripper.state(), tuple(valve.state() for valve in rig.valves)
    on_images()
    rig.clock.start(deadline)
    touch = tuple(pipeline.perceive(image, now) for pipeline, image in zip(pipelines, images, strict=True))
    felt = wall.perf_counter()
    observation = Observation(now, rig.period, touch, gripper, valves, last)
    thought = wall.perf_counter()
    wanted = controller.step(observation)
    controller_ms = 1e3 * (wall.perf_counter() - thought)
    sent = rig.gripper.command(rig.limits.apply(wanted, last, rig.period))
    sent = replace(sent, phase=wanted.phase, memory=wanted.memory)
    on_cycle(Cycle(now, images, touch, gripper, valves, wanted, sent,
                   1e3 * (seen - begin), 1e3 * (felt - seen), controller_ms))
    return sent
