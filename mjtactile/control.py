"""The control loop: image, touch, observation, controller, command, record. The same for every rig.

It sees a rig through its Protocols only, and never ground truth. `mjtactile.grasp` puts a job around it.
"""

from __future__ import annotations

import math
import time as wall
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from mjtactile.controller import Controller
from mjtactile.errors import ControllerError, DeviceError, MjtactileError
from mjtactile.parallel import Chain, perceive
from mjtactile.rig import Camera, Rig
from mjtactile.safety import Supervisor
from mjtactile.types import Command, GripperState, Image, Observation, Touch, ValveState

REFERENCE_IMAGES = 10  # averaging ten takes the reference's noise to a third of an image's
PATIENCE = 2.0  # s to wait for an image before anything moves
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
    state: str = "running"
    reason: str = ""
    last: Command | None = None


def take_references(rig: Rig, pipelines: Sequence[Chain], report: Callable[[str], None] = lambda _: None,
                    on_reference: Callable[[str, list[list[Image]], list[float | None]], None] = lambda *_: None) -> None:
    """Let every sensor measure itself: flat with the valve open to the air, then inflated, sealed, and touching nothing.

    Raises DeviceError when what the cameras see does not agree with the sensor file.
    """
    supply = rig.design.chamber.supply_gauge
    report("reference: flat, valve open")
    for valve in rig.valves:
        valve.open(0.0)
    shots = settled_images(rig)
    on_reference("flat", shots, [0.0 for _ in rig.valves])
    for pipeline, images in zip(pipelines, shots, strict=True):
        pipeline.take_flat(images)
    report("reference: inflated, nothing touching")
    for valve in rig.valves:
        valve.open(supply)
    rig.clock.wait_until(rig.clock.now() + SETTLE_TIME)
    for valve in rig.valves:
        valve.close()
    shots = settled_images(rig)
    pressures = [valve.state().pressure_gauge for valve in rig.valves]
    on_reference("rest", shots, pressures)
    for pipeline, measured, images in zip(pipelines, pressures, shots, strict=True):
        pipeline.take_rest(images, supply if measured is None else measured)


def settled_images(rig: Rig) -> list[list[Image]]:
    """Wait until everything is still, then return REFERENCE_IMAGES images of each camera."""
    rig.clock.wait_until(rig.clock.now() + SETTLE_TIME)
    shots: list[list[Image]] = [[] for _ in rig.cameras]
    for _ in range(REFERENCE_IMAGES):
        for camera, images in zip(rig.cameras, shots, strict=True):
            images.append(_patient_read(rig, camera))
        rig.clock.wait_until(rig.clock.now() + rig.period)
    return shots


def _patient_read(rig: Rig, camera: Camera) -> Image:
    """An image while nothing moves yet: a late one is waited for. Raises DeviceError when none comes."""
    deadline = rig.clock.now() + PATIENCE
    while True:
        try:
            return camera.read()
        except DeviceError:
            if rig.clock.now() > deadline:
                raise
            rig.clock.wait_until(rig.clock.now() + rig.period)


def run(rig: Rig, pipelines: Sequence[Chain], controller: Controller, *, time_limit: float,
        on_cycle: Callable[[Cycle], None], on_images: Callable[[], None] = lambda: None,
        supervisor: Supervisor | None = None) -> Command:
    """Run the controller until it says "done" or "abort"; returns the last command sent.

    `on_images` is called when a cycle's images were taken and the world still stands at that time, `on_cycle` after
    its command was sent. A controller that fails, or takes longer than `time_limit` s, is asked no more: the hand goes
    down and opens first, and then the error is raised. Raises ControllerError, DeviceError (also when a fault brought the
    rig to its safe state), SimulationError; the caller closes the rig.
    """
    state = rig.gripper.state()
    command = Command(opening=state.opening, force_limit=0.0, lift_height=state.lift_height)
    start = deadline = rig.clock.now()
    loop = _Loop(rig, pipelines, controller, supervisor or Supervisor(rig.period), on_images, on_cycle)
    loop.supervisor.arm(start)
    while command.phase not in ("done", "abort") and not loop.supervisor.is_over:
        if rig.clock.now() - start > time_limit:
            late = DeviceError(f"controller {controller.path}: still in phase {command.phase!r} after {time_limit:g} s")
            loop.give_up(late, rig.clock.now(), command)
        # A cycle that was missed is not made up for; one that began early, with its picture, counts from then.
        deadline = min(max(deadline, rig.clock.now() - rig.period), rig.clock.now()) + rig.period
        command = loop.turn(command, deadline)
        rig.clock.wait_until(deadline)
    if loop.supervisor.is_over:
        raise loop.failure or DeviceError(f"stopped safely: {loop.supervisor.reason}")
    return command


@dataclass(eq=False)
class _Loop:
    """What stays the same from cycle to cycle, and what the sensors said last."""

    rig: Rig
    pipelines: Sequence[Chain]
    controller: Controller
    supervisor: Supervisor
    on_images: Callable[[], None]
    on_cycle: Callable[[Cycle], None]
    images: tuple[Image, ...] = ()
    touch: tuple[Touch, ...] = ()
    failure: MjtactileError | None = None

    def turn(self, last: Command, deadline: float) -> Command:
        """One cycle from the images to the command that was sent. The world moves on meanwhile.

        A blind camera makes the force unknown; a gripper or valve that fails makes the supervisor take over.
        """
        rig, begin = self.rig, wall.perf_counter()
        blind = self._look()
        seen = wall.perf_counter()
        now = rig.clock.now()
        try:
            rig.gripper.ask()
            valves = tuple(valve.state() for valve in rig.valves)
            self.on_images()
            rig.clock.start(deadline)
            self._feel(now, blind)
            gripper = rig.gripper.state()
        except DeviceError as error:
            return self._retreat(str(error), now, last, deadline)
        felt = wall.perf_counter()
        observation = Observation(now, rig.period, self.touch, gripper, valves, last)
        thought = wall.perf_counter()
        wanted = self._think(observation)
        controller_ms = 1e3 * (wall.perf_counter() - thought)
        safe = self.supervisor.decide(now, wanted, last, self.touch, valves)
        sent = rig.gripper.command(rig.limits.apply(safe, last, rig.period))
        sent = replace(sent, phase=safe.phase, memory=safe.memory)
        self.on_cycle(Cycle(now, self.images, self.touch, gripper, valves, wanted, sent, 1e3 * (seen - begin),
                            1e3 * (felt - seen), controller_ms, self.supervisor.state, self.supervisor.reason, last))
        return sent

    def _think(self, observation: Observation) -> Command:
        """What the controller wants; once the hand retreats it is not asked any more, and what it last got stands."""
        if self.supervisor.state == "safe":
            return observation.command
        try:
            return self.controller.step(observation)
        except ControllerError as error:
            self.give_up(error, observation.time, observation.command)
            return observation.command

    def give_up(self, error: MjtactileError, now: float, last: Command) -> None:
        """Retreat because of `error`, unless the hand does already; it is raised when that is done."""
        if self.supervisor.state != "safe":
            self.failure = error
            self.supervisor.make_safe(str(error), now, last)

    def _look(self) -> str:
        """Take the newest images; what is wrong with the cameras, "" for nothing. The first images must come."""
        if not self.images:
            self.images = tuple(_patient_read(self.rig, camera) for camera in self.rig.cameras)
            return ""
        try:
            self.images = tuple(camera.read() for camera in self.rig.cameras)
        except DeviceError as error:
            return str(error)
        return ""

    def _feel(self, now: float, blind: str) -> None:
        """From images to touch; a stale image says nothing, so the force is unknown and not what it was."""
        if blind:
            self.touch = tuple(replace(t, age=now - t.time, force_normal=math.nan, force_normal_sd=math.nan, touching=False,
                                       contact=None, traction=None, surface=None, markers=None, status=blind)
                               for t in self.touch)
        else:
            self.touch = perceive(self.pipelines, self.images, now)

    def _retreat(self, reason: str, now: float, last: Command, deadline: float) -> Command:
        """The gripper or a valve failed: go down and open with what still obeys, without asking the controller."""
        rig = self.rig
        self.supervisor.make_safe(reason, now, last)
        wanted = self.supervisor.decide(now, last, last, (), ())
        rig.clock.start(deadline)
        try:
            return replace(rig.gripper.command(rig.limits.apply(wanted, last, rig.period)), phase=last.phase, memory=last.memory)
        except DeviceError:  # nothing obeys any more: the devices' own watchdogs act
            self.supervisor.latch(reason, now)
            return last
