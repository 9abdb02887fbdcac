"""The control loop: image, touch, observation, controller, command, record. The same for every rig.

`mjtactile.run.session` puts references and a rig around it.
"""

from __future__ import annotations

import math
import time as wall
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from mjtactile.core.errors import ControllerError, DeviceError, Interrupted, SimulationError
from mjtactile.core.signals import Stop
from mjtactile.core.status import Status, StatusCode
from mjtactile.core.types import Command, GripperState, Image, Observation, Touch, ValveState
from mjtactile.rig.finger import Rig
from mjtactile.rig.protocols import Camera
from mjtactile.run.controller import ControllerThread, Stepper
from mjtactile.run.feelers import Feelers
from mjtactile.run.perceive import Perceiver, Perceivers, unknown_touch
from mjtactile.run.supervisor import HEIGHT_TOLERANCE, Supervisor

PATIENCE = 2.0  # s to wait for an image before anything moves
# s that a world which waits gives a perception or a controller; the real one gives a share of its
# host_timeout:
WAIT_TIME = 10.0
# 0.1 and 0.2 s of 0.25 s, so that the devices never take the loop for dead
FEEL_SHARE = 0.4
STEP_SHARE = 0.8
ENDS = ("done", "abort")  # phases
UNKNOWN_GRIPPER = GripperState(math.nan, math.nan, math.nan, math.nan)


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


def patient_read(rig: Rig, camera: Camera) -> Image:
    """An image while nothing moves yet: a late one is waited for. Raises DeviceError when none
    comes."""
    deadline = rig.clock.now() + PATIENCE
    while True:
        try:
            return camera.read()
        except DeviceError:
            if rig.clock.now() > deadline:
                raise
            rig.clock.wait_until(rig.clock.now() + rig.period)


def run_loop(
    rig: Rig,
    perceptions: Sequence[Perceiver],
    controller: Stepper,
    *,
    time_limit: float,
    on_cycle: Callable[[Cycle], None],
    on_images: Callable[[], None] = lambda: None,
    supervisor: Supervisor | None = None,
    stop: Stop | None = None,
    threads: int | None = None,
    feelers: Feelers | None = None,
) -> Command:
    """Run the controller until it says "done" or "abort"; returns the last command sent.

    `on_images` is called when a cycle's images were taken and the world still stands at that time,
    `on_cycle` after its command was sent, in every cycle; `feelers` perceive, else `threads` beside
    it (None: as many as are worth it here). Whatever fails, takes longer than `time_limit` s, or
    ends with the hand in the air: the controller is asked no more, the hand goes down and opens
    first, and then the error is raised; so also when `stop` was asked for, and without any delay
    when it shall be at once. Raises ControllerError, DeviceError (also when a fault brought the rig
    to its safe state), Interrupted, SimulationError; the caller closes the rig.
    """
    stop = stop or Stop()
    state = rig.gripper.state()
    command = Command(opening=state.opening, force_limit=0.0, lift_height=state.lift_height)
    start = deadline = rig.clock.now()
    names = [finger.name for finger in rig.fingers]
    perceivers = (
        Perceivers(perceptions, names, threads, busy=rig.scene is not None)
        if feelers is None
        else feelers.at_work(perceptions, names)
    )
    with (
        ControllerThread(controller, min(STEP_SHARE * rig.host_timeout, WAIT_TIME)) as guarded,
        perceivers as felt,
    ):
        loop = _Loop(
            rig,
            felt,
            guarded,
            supervisor or Supervisor(rig.period),
            on_images,
            on_cycle,
            start,
            command,
        )
        loop.supervisor.arm(start)
        while not loop.supervisor.is_over:
            if stop.at_once:
                raise Interrupted
            if stop.asked:
                loop.give_up(Interrupted())
            elif rig.clock.now() - start > time_limit:
                late = (
                    f"controller {controller.path}: still in phase {command.phase!r} after "
                    f"{time_limit:g} s"
                )
                loop.give_up(DeviceError(late))
            elif command.phase in ENDS and loop.supervisor.state != "safe":
                if command.lift_height < HEIGHT_TOLERANCE:
                    break
                loop.supervisor.make_safe(
                    f"the controller ended ({command.phase}) with the hand in the air",
                    loop.now,
                    command,
                )
            # A cycle that was missed is not made up for; one that began early, with its picture,
            # counts from then.
            deadline = (
                min(max(deadline, rig.clock.now() - rig.period), rig.clock.now()) + rig.period
            )
            command = loop.turn(command, deadline)
            rig.clock.wait_until(deadline)
    if loop.failure is not None:
        raise loop.failure
    if command.phase not in ENDS:
        raise DeviceError(f"stopped safely: {loop.supervisor.reason}")
    return command


@dataclass(eq=False)
class _Loop:
    """What stays the same from cycle to cycle, and what cameras, sensors and devices said last."""

    rig: Rig
    perceptions: Perceivers | Feelers
    controller: ControllerThread
    supervisor: Supervisor
    on_images: Callable[[], None]
    on_cycle: Callable[[Cycle], None]
    now: float
    last: Command
    images: tuple[Image, ...] = ()
    touch: tuple[Touch, ...] = ()
    valves: tuple[ValveState, ...] = ()
    gripper: GripperState = UNKNOWN_GRIPPER
    failure: Exception | None = None

    def turn(self, last: Command, deadline: float) -> Command:
        """One cycle from the images to the command that was sent. The world moves on meanwhile.

        A blind camera makes the force unknown; whatever else fails makes the supervisor take over.
        """
        rig = self.rig
        begin = wall.perf_counter()
        self.last = last
        blind = self._look()
        seen = wall.perf_counter()
        self.now = rig.clock.now()
        self._try(rig.gripper.ask)
        if not self._try(self._look_at_valves):
            self.valves = tuple(
                replace(valve, pressure_gauge=None, time=math.nan, age=math.nan)
                for valve in self.valves
            )
        self._try(self.on_images)
        rig.clock.start(deadline)
        if blind or not self._try(self._feel):
            status = (
                Status(StatusCode.NO_IMAGE, blind)
                if blind
                else Status(StatusCode.NO_ANSWER, self.supervisor.reason)
            )
            self.touch = tuple(unknown_touch(image, self.now, status) for image in self.images)
        if not self._try(self._look_at_gripper):
            self.gripper = UNKNOWN_GRIPPER
        felt = wall.perf_counter()
        wanted = self._think()
        controller_ms = 1e3 * (wall.perf_counter() - felt)
        sent = self._send(self.supervisor.decide(self.now, wanted, last, self.touch, self.valves))
        cycle = Cycle(
            self.now,
            self.images,
            self.touch,
            self.gripper,
            self.valves,
            wanted,
            sent,
            1e3 * (seen - begin),
            1e3 * (felt - seen),
            controller_ms,
            self.supervisor.state,
            self.supervisor.reason,
            last,
        )
        self._try(lambda: self.on_cycle(cycle))
        return sent

    def give_up(self, error: Exception) -> None:
        """Retreat because of `error`, unless the hand does already; it is raised when that is
        done."""
        if self.supervisor.state != "safe":
            self.failure = error
            self.supervisor.make_safe(str(error), self.now, self.last)

    def _try(self, act: Callable[[], None]) -> bool:
        """Do what may fail; whatever does is no reason to drop what the hand holds, but one to set
        it down."""
        try:
            act()
        except SimulationError:  # there is no world any more to set it down in
            raise
        except DeviceError as error:
            self.supervisor.make_safe(str(error), self.now, self.last)
        except Exception as error:  # noqa: BLE001
            # also a mistake in this package, or in what a caller wants to be told
            self.give_up(error)
        else:
            return True
        return False

    def _look(self) -> str:
        """Take the newest images; what is wrong with the cameras, "" for nothing. The first images
        must come."""
        if not self.images:
            self.images = tuple(patient_read(self.rig, camera) for camera in self.rig.cameras)
            return ""
        try:
            self.images = tuple(camera.read() for camera in self.rig.cameras)
        except DeviceError as error:
            return str(error)
        return ""

    def _look_at_valves(self) -> None:
        self.valves = tuple(valve.state() for valve in self.rig.valves)

    def _look_at_gripper(self) -> None:
        self.gripper = self.rig.gripper.state()

    def _feel(self) -> None:
        self.touch = self.perceptions.perceive(
            self.images, self.now, min(FEEL_SHARE * self.rig.host_timeout, WAIT_TIME)
        )

    def _think(self) -> Command:
        """What the controller wants; once the hand retreats it is not asked any more, and what it
        last got stands."""
        if self.supervisor.state != "safe":
            try:
                return self.controller.step(
                    Observation(
                        self.now, self.rig.period, self.touch, self.gripper, self.valves, self.last
                    )
                )
            except ControllerError as error:
                self.give_up(error)
        return self.last

    def _send(self, command: Command) -> Command:
        """What of `command` was sent; nothing if nothing obeys any more, and then the devices' own
        watchdogs act."""
        rig = self.rig
        try:
            sent = rig.gripper.command(rig.limits.apply(command, self.last, rig.period))
        except DeviceError as error:
            self.supervisor.latch(str(error), self.now)
            return self.last
        return replace(sent, phase=command.phase, memory=command.memory)
