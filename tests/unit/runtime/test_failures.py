"""Tests of failures in the control loop, on a rig of stubs: the held object is always set down
first."""

import math
import pickle
import re
import resource
import sys
import threading
from dataclasses import replace
from enum import Enum
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mjtactile.core import memory_limit
from mjtactile.core.errors import ControllerError, DeviceError, Interrupted
from mjtactile.core.signals import Stop
from mjtactile.core.types import Command
from mjtactile.core.types.command import MEMORY_MAX
from mjtactile.recording.observer import Observer
from mjtactile.rig.command_limits import CommandLimits
from mjtactile.runtime import control_loop
from mjtactile.runtime.controller import Controller
from mjtactile.runtime.cycle import ControlCycle
from mjtactile.runtime.supervisor import Supervisor
from tests.stub_rig import OK, PERCEPTION_STUB, PERIOD, World


@pytest.mark.parametrize(
    "raised", [SystemExit(0), KeyboardInterrupt(), GeneratorExit(), ZeroDivisionError()]
)
def test_a_controller_that_raises_an_unexpected_error(raised, tmp_path):
    def step(observation):
        if observation.time > 0.2:
            raise raised
        return observation.command

    world = World()
    _, message = world.run(
        "", controller=Controller(tmp_path / "mine.py", step).step, error=ControllerError
    )
    assert f"step() raised {type(raised).__name__}" in message
    assert world.has_set_down()


@pytest.mark.skipif(sys.platform != "linux", reason="no limit of a process's memory elsewhere")
@pytest.mark.parametrize("greedy", ["at once", "in a list", "in the notebook"])
def test_a_step_beyond_the_memory_limit_is_refused_and_the_gripper_lowers(greedy):
    """A step beyond the memory limit is rejected, and the gripper lowers. The step gets less than
    one of 16 GB: allocation of all of them would stop the loop for seconds. The limit is one GB
    more than the process's use at the start, since memory freed by others may be allocated again.
    """
    eaten = []
    had = memory_limit._used()
    maximum = [had]

    def step(observation):
        if observation.time > 0.2:
            if greedy == "in a list":
                while True:
                    eaten.append(
                        np.empty(64 << 20, np.uint8)
                    )  # requested memory counts, unused as well
                    maximum.append(memory_limit._used())
            many = [0.0] * (2 << 30)
            return replace(observation.command, memory={"many": many})
        return observation.command

    def wide(observation):
        late = observation.time > 0.2
        memory = dict.fromkeys(range(MEMORY_MAX + 1), 0.0) if late else {}
        return replace(observation.command, memory=memory)

    world = World()
    before = resource.getrlimit(resource.RLIMIT_DATA)
    controller = Controller(Path(__file__), wide if greedy == "in the notebook" else step)
    _, message = world.run("", controller=controller.step, error=ControllerError, host_timeout=5.0)
    assert ("MemoryError" in message) == (greedy != "in the notebook"), message
    assert world.has_set_down() and max(maximum) - had < 1 << 30
    assert resource.getrlimit(resource.RLIMIT_DATA) == before


def test_a_loop_without_memory_sets_down():
    """Without memory, the loop releases the controller's stored data, and the gripper retreats.

    This holds wherever the error occurs.
    """
    kept = []

    def step(observation):
        kept.append(dict(observation.command.memory))
        return replace(observation.command, memory={"a": 1.0})

    def plain(memory):
        if memory and len(kept) == 5:
            raise MemoryError
        return dict(memory), ()

    world = World()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(control_loop, "plain", plain)
        _, message = world.run("", controller=step, error=DeviceError)
    assert "no memory is left" in message and world.has_set_down()


def unchecked_command(**values):
    """Change a Command without its own checks."""

    def change(command):
        for name, value in values.items():
            object.__setattr__(command, name, value)
        return command

    return change


class UninitializedCommand(Command):
    """Command without initialization."""

    opening = property(lambda self: 1 / 0)  # type: ignore[assignment]


BAD_COMMANDS = {
    "opening that is no number": unchecked_command(opening=math.nan),
    "opening that is text": unchecked_command(opening="wide"),
    "force limit beyond floats": unchecked_command(force_limit=10**400),
    "phase that is none": unchecked_command(phase="fly"),
    "phase that is a list": unchecked_command(phase=["hold"]),
    "memory that is a number": unchecked_command(memory=5),
    "subclass whose values raise": lambda command: object.__new__(UninitializedCommand),
    "no command": lambda command: SimpleNamespace(opening=0.0),
}


@pytest.mark.parametrize("change", BAD_COMMANDS.values(), ids=BAD_COMMANDS)
def test_a_command_made_past_its_checks_leads_to_the_retreat(change):
    def step(observation):
        bad = observation.time > 0.2
        return change(replace(observation.command)) if bad else observation.command

    world = World()
    cycles, message = world.run("", controller=step, error=ControllerError)
    assert "test_failures.py: step: step() raised" in message
    assert world.has_set_down() and len(cycles) == len(world.sent)


@pytest.mark.parametrize("change", BAD_COMMANDS.values(), ids=BAD_COMMANDS)
def test_every_send_error_leads_to_the_retreat(change):
    """Values are checked where they are obeyed, too: not every command is a controller's."""
    world = World()
    cycle = ControlCycle.start(world.rig(), PERCEPTION_STUB, Supervisor(PERIOD), Observer())
    cycle.read_sensors()
    cycle.observe()
    sent = cycle.send(change(Command(0.05, 4.0, 0.02, "hold")))
    assert cycle.failure is not None and cycle.supervisor.state == "safe"
    assert world.sent == [sent] and sent.lift_height < 0.02  # on its way down, in the same cycle


def test_a_retreat_that_cannot_be_sent_is_the_end():
    world = World()
    world.command = lambda command: 1 / 0  # type: ignore[method-assign]
    cycle = ControlCycle.start(world.rig(), PERCEPTION_STUB, Supervisor(PERIOD), Observer())
    cycle.read_sensors()
    cycle.observe()
    cycle.send(Command(0.05, 4.0))
    assert cycle.supervisor.is_over and isinstance(cycle.failure, ZeroDivisionError)


def test_a_memory_that_cannot_be_written_is_reported_once_and_the_grasp_continues():
    """Controller memory that cannot be written is reported once, and the grasp continues.

    Recorders and viewers get plain values; the controller keeps its own.
    """
    cyclic: list = [1.0]
    cyclic.append(cyclic)
    strange = {
        "colour": Enum("Colour", ["RED"]).RED,
        "plan": lambda: None,
        "loop": cyclic,
        "many": [0.0] * 100_000,
    }
    listener = Listener()
    world = World()
    world.lift = 0.0

    def step(observation):
        is_over = observation.command.memory.get("count", 0) >= 5
        assert not is_over or observation.command.memory["loop"] is cyclic
        count = observation.command.memory.get("count", 0) + 1
        phase = "done" if is_over else "hold"
        return replace(observation.command, phase=phase, memory={"count": count, **strange})

    last = control_loop.run_loop(
        world.rig(),
        [SimpleNamespace(perceive=lambda image, now, reading=None: OK)],  # type: ignore[list-item]
        SimpleNamespace(path=Path("mine.py"), step=step),  # type: ignore[arg-type]
        time_limit=30.0,
        observer=listener,
    )
    assert last.phase == "done"
    assert [cycle.sent.memory for cycle in listener.cycles] == [{"count": k + 1} for k in range(6)]
    assert pickle.loads(pickle.dumps(listener.cycles[-1].sent)) == listener.cycles[-1].sent
    assert [len(noted) for noted in listener.noted] == [4] and len(listener.messages) == 1
    assert "plan (function)" in listener.messages[0]


class Listener(Observer):
    def __init__(self):
        self.cycles: list = []
        self.noted: list = []
        self.messages: list = []

    def add(self, cycle, view=None, **truth):
        self.cycles.append(cycle)

    def note(self, **facts):
        self.noted.append(facts["memory_left_out"])

    def message(self, text):
        self.messages.append(text)


def test_a_controller_that_does_not_return():
    ended = threading.Event()

    def step(observation):
        try:
            while observation.time > 0.2:
                pass
        finally:
            if observation.time > 0.2:
                ended.set()
        return observation.command

    world = World()
    cycles, message = world.run("", controller=step, error=ControllerError, host_timeout=0.25)
    assert "step() did not return within 0.2 s" in message
    # where it hangs
    assert re.search(r"test_failures.py: line \d+: step\(\) did not return", message)
    assert ended.wait(10)  # the thread was stopped, and uses no more processor time
    assert world.has_set_down() and len(cycles) == len(world.sent)


def test_module_state_and_thread_of_a_controller_last_for_the_run():
    calls = []
    threads = set()

    def step(observation):
        calls.append(observation.time)
        threads.add(threading.current_thread())
        return replace(
            observation.command, phase="done" if len(calls) == 5 else "hold", lift_height=0.0
        )

    world = World()
    world.lift = 0.0
    controller = SimpleNamespace(path=Path("mine.py"), step=step)
    last = control_loop.run_loop(
        world.rig(),
        [SimpleNamespace(perceive=lambda image, now, reading=None: OK)],
        controller,  # type: ignore[list-item, arg-type]
        time_limit=30.0,
    )
    assert last.phase == "done" and len(calls) == 5 and len(threads) == 1


@pytest.mark.parametrize("phase", ["done", "abort"])
def test_a_controller_that_ends_with_the_gripper_in_the_air(phase):
    world = World()
    controller = SimpleNamespace(
        path=Path("mine.py"), step=lambda o: replace(o.command, phase=phase)
    )
    last = control_loop.run_loop(
        world.rig(),
        [SimpleNamespace(perceive=lambda image, now, reading=None: OK)],
        controller,  # type: ignore[list-item, arg-type]
        time_limit=30.0,
    )
    assert last.phase == phase and world.has_set_down()


def test_an_observer_of_a_cycle_that_fails():
    def act():
        raise OSError("no space left")

    world = World()
    cycles, message = world.run("", act=act, error=OSError)
    assert message == "no space left" and world.has_set_down()
    assert len(cycles) == len(world.sent)  # and it receives all other cycles


def test_a_pipeline_that_fails():
    def perceive(image, now, reading=None):
        if image.time > 0.2:
            raise ValueError("singular matrix")
        return OK

    world = World()
    cycles, message = world.run("", perceive=perceive, error=ValueError)
    assert message == "singular matrix" and world.has_set_down()
    assert (
        math.isnan(cycles[-1].touch[0].force_normal)
        and cycles[-1].touch[0].status.code == "perception timeout"
    )


def test_a_signal():
    stop = Stop()
    world = World()
    cycles, _ = world.run(
        "", act=lambda: setattr(stop, "asked", True), error=Interrupted, stop=stop
    )
    assert world.has_set_down() and cycles[5].state == "safe"


def test_a_second_signal_ends_at_once():
    stop = Stop()
    world = World()

    def act():
        stop.asked = True
        stop.at_once = len(world.sent) >= 8

    cycles, _ = world.run("", act=act, error=Interrupted, stop=stop)
    assert len(cycles) == 8 and world.lift > 0.015


def test_a_controller_cannot_close_without_an_image():
    world = World()
    world.run("camera", controller=lambda o: replace(o.command, opening=0.0, lift_height=1.0))
    at = world.sent[4].opening
    assert all(command.opening >= at for command in world.sent[5:])


def test_a_controller_cannot_exceed_the_limits():
    limits = CommandLimits(opening=(0.01, 0.1), speed=0.1, force=5.0)
    sent = limits.apply(Command(0.5, 99.0, 9.0), Command(0.099, 1.0), 0.05)
    assert (sent.opening, sent.force_limit) == (0.1, 5.0)
    sent = limits.apply(Command(0.0, 1.0), Command(0.05, 1.0), 0.05)
    assert sent.opening == pytest.approx(0.05 - 0.1 * 0.05)
