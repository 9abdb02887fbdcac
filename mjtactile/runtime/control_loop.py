"""The control loop: image, touch, observation, controller, command, record. The same for every rig.

`mjtactile.runtime.session` puts references and a rig around it.
"""

from __future__ import annotations

import contextlib
import math
import time as wall
from collections.abc import Callable, Sequence
from dataclasses import replace

from mjtactile.core import memory_limit
from mjtactile.core.controller_state import plain
from mjtactile.core.errors import ControllerError, Interrupted, SafeStop
from mjtactile.core.signals import Stop
from mjtactile.core.types import Command, Observation
from mjtactile.recording.observer import Observer
from mjtactile.rig.finger import Rig
from mjtactile.runtime.controller import ControllerThread, LoadedController
from mjtactile.runtime.cycle import WAIT_TIME, ControlCycle, Cycle
from mjtactile.runtime.perception_processes import PerceptionPool
from mjtactile.runtime.perception_threads import Perceiver, Perceivers
from mjtactile.runtime.retreat import may_hold
from mjtactile.runtime.set_down import ENDS, RELEASE_HEIGHT
from mjtactile.runtime.supervisor import Supervisor

# 0.2 s of 0.25 s, so that the devices never treat the loop as stopped
_STEP_FRACTION = 0.8
_IN_THE_AIR = 5e-3  # maximum measured height above the commanded one for a lowered gripper, m


def run_loop(
    rig: Rig,
    perceptions: Sequence[Perceiver],
    controller: LoadedController,
    *,
    time_limit: float,
    observer: Observer | None = None,
    supervisor: Supervisor | None = None,
    stop: Stop | None = None,
    threads: int | None = None,
    pool: PerceptionPool | None = None,
) -> Command:
    """Run the controller until it returns the phase "done" or "abort".

    The loop stops early on an error, after `time_limit`, or on request through `stop`. It also
    stops if the controller ends with the gripper raised. The controller is then no longer called.
    The gripper is lowered and opened first, and the error is raised afterwards. An immediate stop
    skips this retreat.

    The caller closes the rig. `perceptions` are the sensing pipelines of its fingers, with
    references taken. The `observer` is called in every cycle with `on_images`, then `add`.
    `threads` is the number of perception threads in addition to the loop (None: automatic). `pool`
    are perception processes in their place.

    Returns the last command sent. Raises ControllerError; DeviceError, also after a fault brought
    the rig to its safe state; Interrupted, if `stop` was requested; SimulationError.
    """
    stop = stop or Stop()
    names = [finger.name for finger in rig.fingers]
    if pool is None:
        perceivers = Perceivers(perceptions, names, threads, busy=rig.scene is not None)
    else:
        perceivers = pool.using(perceptions, names)
    # a simulated world waits for the process, so memory limits apply to real rigs only
    is_real = math.isfinite(rig.host_timeout)
    memory = memory_limit.limited() if is_real else contextlib.nullcontext(lambda: None)
    with (
        ControllerThread(controller, min(_STEP_FRACTION * rig.host_timeout, WAIT_TIME)) as guarded,
        perceivers as perceiving,
        memory as limit_memory,
    ):
        supervisor = supervisor or Supervisor(rig.period)
        cycle = ControlCycle.start(rig, perceiving, supervisor, observer or Observer())
        _run_cycles(cycle, guarded, stop, limit_memory, time_limit)
    _report_flag(cycle)
    if cycle.failure is not None:
        raise cycle.failure
    reason = cycle.supervisor.reason
    if cycle.supervisor.unverified:
        raise SafeStop(f"stopped, not verified safe: {reason}; {cycle.supervisor.unverified}")
    if cycle.last.phase not in ENDS:
        raise SafeStop(f"stopped safely: {reason}")
    return cycle.last


def _report_flag(cycle: ControlCycle) -> None:
    """Report and record that the safe state is not verified, before any error is raised."""
    if unverified := cycle.supervisor.unverified:
        cycle.attempt(lambda: cycle.observer.message(f"not verified safe: {unverified}"))
        cycle.attempt(lambda: cycle.observer.note(not_verified_safe=unverified))


def _run_cycles(
    cycle: ControlCycle,
    guarded: ControllerThread,
    stop: Stop,
    limit_memory: Callable[[], None],
    time_limit: float,
) -> None:
    """Run one cycle per period until the supervisor is latched or the gripper has landed."""
    rig = cycle.rig
    start = deadline = cycle.now
    while not cycle.supervisor.is_over:
        if stop.at_once:
            raise Interrupted
        if stop.asked:
            cycle.start_retreat(Interrupted())
        elif rig.clock.now() - start > time_limit:
            phase = f"still in phase {cycle.last.phase!r} after {time_limit:g} s"
            message = f"controller {guarded.controller.path}: {phase}"
            cycle.start_retreat(SafeStop(message, kind="hung"))
        elif _has_landed(cycle):
            break
        # A missed cycle is not repeated. If a cycle and its image are early, the next period counts
        # from then.
        now = rig.clock.now()
        deadline = min(max(deadline, now - rig.period), now) + rig.period
        try:
            _run_cycle(cycle, guarded, deadline)
        except MemoryError:
            _handle_memory_exhaustion(cycle)
        limit_memory()  # not before the first step, which may import
        rig.clock.wait_until(deadline)


def _has_landed(cycle: ControlCycle) -> bool:
    """Return True if the controller has ended with the gripper down.

    An empty gripper above the commanded placement, or above an object that stood on the table when
    the fingers opened, also counts. If the controller ends with the gripper raised, the retreat
    starts.
    """
    command = cycle.last
    if command.phase not in ENDS or cycle.supervisor.state == "safe":
        return False
    is_up = cycle.gripper.lift_height > command.lift_height + _IN_THE_AIR
    if command.lift_height <= RELEASE_HEIGHT and not is_up:
        return True
    is_placed = cycle.rig.goal.place_height > 0 or (cycle.set_down.stood and not is_up)
    if is_placed and not any(map(may_hold, cycle.touch)):
        return True
    why = f"the controller ended ({command.phase}) with the gripper raised"
    cycle.supervisor.make_safe(why, cycle.now)
    return False


def _run_cycle(cycle: ControlCycle, controller: ControllerThread, deadline: float) -> None:
    """Run one cycle, from the images to the sent command, while the world continues to move."""
    before = cycle.last
    cycle.read_sensors()
    cycle.rig.clock.advance_towards(deadline)
    observation = cycle.observe()
    start = wall.perf_counter()
    requested = _compute_command(cycle, controller, observation)
    controller_ms = 1e3 * (wall.perf_counter() - start)
    sent = cycle.send(requested)
    memory, left_out = plain(sent.memory)
    turn = Cycle(
        cycle.now,
        cycle.images,
        cycle.touch,
        cycle.gripper,
        cycle.valves,
        replace(requested, memory=memory),
        replace(sent, memory=memory),
        cycle.camera_ms,
        cycle.perception_ms,
        controller_ms,
        cycle.supervisor.state,
        cycle.supervisor.reason,
        replace(before, memory={}),
    )
    cycle.attempt(lambda: cycle.observer.add(turn))
    if left_out and not cycle.left_out:
        cycle.left_out = left_out
        cycle.attempt(lambda: _report_disabled_effects(cycle))


def _handle_memory_exhaustion(cycle: ControlCycle) -> None:
    """Discard the controller's memory and start the retreat after the process ran out of memory.

    If the gripper was already retreating, latch the supervisor. The devices' own watchdogs then
    act.
    """
    retreats = cycle.supervisor.state == "safe"
    cycle.last = replace(cycle.last, memory={})
    cycle.start_retreat(SafeStop("stopped safely: no memory is left"))
    if retreats:
        cycle.supervisor.latch("no memory is left", cycle.now, "the retreat was cut short")


def _report_disabled_effects(cycle: ControlCycle) -> None:
    names = ", ".join(cycle.left_out)
    cycle.observer.message(
        f"Command.memory: entries that cannot be written are not recorded: {names}"
    )
    cycle.observer.note(memory_left_out=list(cycle.left_out))


def _compute_command(
    cycle: ControlCycle, controller: ControllerThread, observation: Observation
) -> Command:
    """Return the controller's command; during a retreat, return the last command sent."""
    if cycle.supervisor.state != "safe":
        try:
            return controller.step(observation)
        except ControllerError as error:
            cycle.start_retreat(error)
    return cycle.last
