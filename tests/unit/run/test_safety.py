"""The supervisor's state machine, and the control loop around it, on a rig of stubs."""

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

from mjtactile.core.design import load_sensor
from mjtactile.core.errors import ControllerError, DeviceError, InputError, Interrupted
from mjtactile.core.signals import Stop
from mjtactile.core.types import (
    Command,
    GripperState,
    Image,
    Slip,
    Told,
    Touch,
    Traction,
    ValveState,
)
from mjtactile.core.types.control import MEMORY_MOST
from mjtactile.recording.observer import CycleCallback, Observer
from mjtactile.rig.finger import Finger, Rig
from mjtactile.rig.limits import Limits
from mjtactile.run import loop
from mjtactile.run.controller import Controller
from mjtactile.run.cycle import ControlCycle
from mjtactile.run.supervisor import BLIND_TIME_MAX, RETREAT_OPENING, RETREAT_SPEED, Supervisor

PERIOD = 0.05
OK = Touch(0.0, 0.0, 0.5, 0.01, True)
BLIND = Touch(0.0, 0.0, math.nan, math.nan, False, status="too dark")
SEALED = ValveState(False, 1000.0)
LAST = Command(0.05, 4.0, 0.02, "hold")
FEELS = SimpleNamespace(perceive=lambda images, now, patience, readings: (OK,))


def loaded(shear):
    """A finger along which so many N pull."""
    wrench = np.array([0.0, shear, -1.0, 0.0, 0.0, 0.0])
    grid = np.linspace(-0.01, 0.01, 3)
    traction = Traction(grid, grid, np.zeros((3, 3, 3)), wrench, np.eye(6) * 1e-6, 1e3, "made up")
    return replace(OK, traction=traction)


@pytest.fixture
def supervisor():
    supervisor = Supervisor(PERIOD)
    supervisor.arm(0.0)
    return supervisor


def test_the_reason_of_a_command_passes_limits_and_processes():
    wanted = Command(0.04, 9.0, 0.03, "abort", {"t": 1.0}, reason="closed on nothing")
    sent = pickle.loads(pickle.dumps(Limits(force=5.0).apply(wanted, LAST, PERIOD)))
    assert (sent.reason, sent.force_limit, sent.memory["t"]) == ("closed on nothing", 5.0, 1.0)


@pytest.mark.parametrize(("how", "height"), [("slid", 0.02), ("pushed", 0.01), ("hangs", 0.0)])
def test_the_retreat_ends_where_what_is_held_stands(supervisor, how, height):
    """Until now a bottle that had slid down was driven into the table: down, then open."""
    slid = Slip("slipping", np.zeros(2), 0.02 if how == "slid" else 0.0, 0.0)
    last = Command(0.05, 4.0, 0.04, "hold")
    now = 0.0
    for _ in range(20):
        hanging = replace(loaded(-0.5), slip=slid)
        last = supervisor.decide(now, last, last, (hanging, hanging), ())
        now += PERIOD
    supervisor.make_safe("a reason", now, last)
    lowest = last.lift_height
    while not supervisor.is_over:
        up = 0.5 if how == "pushed" and last.lift_height < 0.01 else -0.5
        felt = BLIND if how == "slid" else loaded(up)  # it slid off the membrane: no shape
        last = supervisor.decide(now, last, last, (felt, felt), ())
        lowest = min(lowest, last.lift_height)
        now += PERIOD
    # a step of the retreat is 1.5 mm
    assert lowest == pytest.approx(height, abs=2e-3)
    assert last.opening == pytest.approx(0.05 + RETREAT_OPENING, abs=1e-3)


def test_known_forces_let_the_controller_through(supervisor):
    wanted = Command(0.04, 4.0, 0.03, "hold")
    assert supervisor.decide(0.1, wanted, LAST, (OK, OK), (SEALED, SEALED)) is wanted
    assert supervisor.state == "running"


def test_unknown_force_neither_closes_nor_lifts(supervisor):
    sent = supervisor.decide(
        0.1, Command(0.04, 4.0, 0.03, "hold"), LAST, (OK, BLIND), (SEALED, SEALED)
    )
    assert (supervisor.state, supervisor.reason) == ("holding", "too dark")
    assert (sent.opening, sent.lift_height) == (LAST.opening, LAST.lift_height)
    opened = supervisor.decide(
        0.15, Command(0.06, 4.0, 0.01, "hold"), LAST, (BLIND, BLIND), (SEALED, SEALED)
    )
    assert (opened.opening, opened.lift_height) == (0.06, 0.01)  # away from harm is let through
    supervisor.decide(0.2, LAST, LAST, (OK, OK), (SEALED, SEALED))
    assert supervisor.state == "running"


def test_blind_for_long_goes_down_then_opens_then_latches(supervisor):
    last = LAST
    states = []
    heights = []
    for step in range(80):
        last = supervisor.decide(
            step * PERIOD, Command(0.03, 4.0, 0.05, "hold"), last, (BLIND, BLIND), (SEALED, SEALED)
        )
        states.append(supervisor.state)
        heights.append((last.lift_height, last.opening))
    assert states.index("safe") == math.floor(BLIND_TIME_MAX / PERIOD) + 1
    assert states[-1] == "latched"
    opened_at = next(i for i, (_, opening) in enumerate(heights) if opening > LAST.opening)
    assert heights[opened_at - 1][0] < 1e-3  # first down
    assert last.opening == pytest.approx(LAST.opening + RETREAT_OPENING, abs=2e-4)
    assert "no force for 0.5 s: too dark" in supervisor.reason


def test_it_never_comes_back_from_safe(supervisor):
    supervisor.make_safe("overload", 0.0, LAST)
    supervisor.decide(0.1, Command(0.03, 4.0), LAST, (OK, OK), (SEALED, SEALED))
    assert supervisor.state == "safe"


@pytest.mark.parametrize("pressures", [(500.0, 1000.0), (1000.0, 600.0)])
def test_a_leak_is_found_by_pressure(supervisor, pressures):
    supervisor.decide(0.0, LAST, LAST, (OK, OK), (SEALED, SEALED))
    supervisor.decide(0.1, LAST, LAST, (OK, OK), tuple(ValveState(False, p) for p in pressures))
    assert supervisor.state == "safe"
    assert "lost pressure" in supervisor.reason


def test_a_leak_is_found_by_shape_without_a_sensor(supervisor):
    def seen(volume):
        return Touch(0.0, 0.0, 0.0, 0.01, False, surface=SimpleNamespace(volume=volume))  # type: ignore[arg-type]

    unknown = ValveState(False)
    supervisor.decide(0.0, LAST, LAST, (seen(1e-6), seen(1e-6)), (unknown, unknown))
    for step in range(3):
        supervisor.decide(
            0.1 + step * PERIOD, LAST, LAST, (seen(4e-7), seen(1e-6)), (unknown, unknown)
        )
    assert supervisor.state == "safe"
    assert "has sunk" in supervisor.reason


# -- the loop
# --------------------------------------------------------------------------------


class World:
    """A rig of stubs whose parts can be told to fail."""

    def __init__(self):
        self.time = 0.0
        self.broken = ""
        self.sent = []
        self.opening = 0.05
        self.lift = 0.02

    def now(self):
        return self.time

    def start(self, time):
        pass

    def wait_until(self, time):
        self.time = max(self.time, time)

    def read(self):
        if self.broken == "camera":
            raise DeviceError("left camera is stale")
        import numpy as np

        return Image(np.zeros((2, 2), np.uint8), self.time)

    def ask(self):
        pass

    def state(self):
        if self.broken in ("gripper", "all"):
            raise DeviceError("servo 1 reports overload")
        return GripperState(self.opening, 0.0, 0.5, self.lift)

    def command(self, command):
        if self.broken == "all":
            raise DeviceError("servo port is lost")
        self.opening = command.opening
        self.lift = command.lift_height
        self.sent.append(command)
        return command

    def rig(self, host_timeout=math.inf):
        return Rig(
            "stub",
            (Finger("left", load_sensor("paper16"), self),),
            self,
            self,
            Limits(),
            close=lambda: None,
            host_timeout=host_timeout,
        )

    def run(
        self,
        broken,
        after=5,
        controller=lambda o: o.command,
        time_limit=30.0,
        error=DeviceError,
        act=lambda: None,
        perceive=lambda image, now, reading=None: OK,
        host_timeout=math.inf,
        stop=None,
    ):
        """Run until `error`; after cycle number `after`, something is `broken`, and `act` is called
        in each cycle."""
        cycles = []

        def on_cycle(cycle):
            cycles.append(cycle)
            if len(cycles) >= after:
                self.broken = broken
                act()

        with pytest.raises(error) as caught:
            loop.run_loop(
                self.rig(host_timeout),
                [SimpleNamespace(perceive=perceive)],  # type: ignore[list-item]
                SimpleNamespace(path=Path(__file__), step=controller),  # type: ignore[arg-type]
                time_limit=time_limit,
                observer=CycleCallback(on_cycle),
                stop=stop,
            )
        return cycles, str(caught.value)

    def has_set_down(self):
        """It went down before it opened, so that nothing was dropped."""
        opened = next(i for i, command in enumerate(self.sent) if command.opening > 0.05 + 1e-3)
        return self.sent[opened].lift_height < 1e-3 and self.opening > 0.05 + RETREAT_OPENING - 1e-3


def test_a_stale_camera_holds_then_opens_and_the_run_ends():
    world = World()
    cycles, message = world.run("camera")
    assert message.startswith("stopped safely: no force for 0.5 s: left camera is stale")
    assert [c.state for c in cycles[5:7]] == ["holding", "holding"]
    assert math.isnan(cycles[5].touch[0].force_normal)  # unknown, neither zero nor the last one
    assert world.lift < 1e-3
    assert world.opening > 0.05 + RETREAT_OPENING - 1e-3


def test_a_faulty_servo_ends_in_the_safe_state_with_its_reason():
    world = World()
    cycles, message = world.run("gripper")
    assert message == "stopped safely: servo 1 reports overload"
    assert len(cycles) == len(world.sent)  # every turn is recorded, the retreat too
    assert all(
        math.isnan(cycle.gripper.opening) and cycle.reason == message.split(": ")[1]
        for cycle in cycles[5:]
    )
    assert cycles[-1].state == "latched" and cycles[-1].touch == (OK,)
    assert world.opening > 0.05 + RETREAT_OPENING - 1e-3


def test_when_nothing_obeys_the_run_ends_at_once():
    world = World()
    cycles, message = world.run("all")
    assert len(cycles) == 6 and cycles[-1].state == "latched"
    assert message == "stopped safely: servo 1 reports overload"


def test_a_controller_that_fails_is_asked_no_more_and_the_hand_retreats_first():
    """Whoever lets go at once drops what the hand holds in the air."""
    asked = []

    def fails(observation):
        asked.append(observation)
        if len(asked) == 3:
            raise ControllerError(
                "step() raised ZeroDivisionError", source="mine.py", field="line 7"
            )
        return observation.command

    world = World()
    cycles, message = world.run("", controller=fails, error=ControllerError)
    assert message == "mine.py: line 7: step() raised ZeroDivisionError"
    assert len(asked) == 3 and cycles[2].state == "safe"
    assert world.lift < 1e-3
    assert world.opening > 0.05 + RETREAT_OPENING - 1e-3


def test_a_controller_that_does_not_end_is_stopped_the_same_way():
    world = World()
    cycles, message = world.run("", time_limit=1.0)
    assert "still in phase 'approach' after 1 s" in message
    assert cycles[29].state == "running" and cycles[32].state == "safe"  # at 30 cycles a second
    assert world.lift < 1e-3
    assert world.opening > 0.05 + RETREAT_OPENING - 1e-3


def test_a_retreat_ends_where_the_jaws_do():
    supervisor = Supervisor(PERIOD)
    supervisor.make_safe("a fault", 0.0, replace(LAST, lift_height=0.0))
    last = replace(LAST, lift_height=0.0)
    widest = LAST.opening + 0.004
    for step in range(8):
        last = supervisor.decide(step * PERIOD, last, last, (), ())
        last = replace(last, opening=min(last.opening, widest))  # as the rig's limits do
    assert supervisor.is_over


# -- whatever fails, what the hand holds is set down first
# -----------------------------------------------------------------


@pytest.mark.parametrize(
    "raised", [SystemExit(0), KeyboardInterrupt(), GeneratorExit(), ZeroDivisionError()]
)
def test_a_controller_that_raises_what_it_should_not(raised, tmp_path):
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
def test_a_step_that_eats_the_memory_is_refused_and_the_hand_goes_down(greedy):
    """Of 16 GB, it gets less than one: handing them out would stop the loop for seconds."""
    eaten = []

    def step(observation):
        if observation.time > 0.2:
            if greedy == "in a list":
                while True:
                    eaten.append(bytearray(b"x" * (64 << 20)))
            many = [0.0] * (2 << 30)
            return replace(observation.command, memory={"many": many})
        return observation.command

    def wide(observation):
        late = observation.time > 0.2
        memory = dict.fromkeys(range(MEMORY_MOST + 1), 0.0) if late else {}
        return replace(observation.command, memory=memory)

    world = World()
    before = resource.getrlimit(resource.RLIMIT_DATA)
    controller = Controller(Path(__file__), wide if greedy == "in the notebook" else step)
    _, message = world.run("", controller=controller.step, error=ControllerError, host_timeout=5.0)
    assert ("MemoryError" in message) == (greedy != "in the notebook"), message
    assert world.has_set_down() and sum(map(len, eaten)) < 1 << 30
    assert resource.getrlimit(resource.RLIMIT_DATA) == before


def test_a_loop_without_memory_sets_down():
    """Wherever it is noticed: what the controller has kept is let go of, and the hand retreats."""
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
        patch.setattr(loop, "plain", plain)
        _, message = world.run("", controller=step, error=DeviceError)
    assert "no memory is left" in message and world.has_set_down()


def past_its_checks(**values):
    """A change of a Command that its own checks do not see."""

    def change(command):
        for name, value in values.items():
            object.__setattr__(command, name, value)
        return command

    return change


class Unmade(Command):
    """One that was never made."""

    opening = property(lambda self: 1 / 0)  # type: ignore[assignment]


BAD_COMMANDS = {
    "opening that is no number": past_its_checks(opening=math.nan),
    "opening that is text": past_its_checks(opening="wide"),
    "force limit beyond floats": past_its_checks(force_limit=10**400),
    "phase that is none": past_its_checks(phase="fly"),
    "phase that is a list": past_its_checks(phase=["hold"]),
    "memory that is a number": past_its_checks(memory=5),
    "subclass whose values raise": lambda command: object.__new__(Unmade),
    "no command": lambda command: SimpleNamespace(opening=0.0),
}


@pytest.mark.parametrize("change", BAD_COMMANDS.values(), ids=BAD_COMMANDS)
def test_a_command_made_past_its_checks_leads_to_the_retreat(change):
    def step(observation):
        bad = observation.time > 0.2
        return change(replace(observation.command)) if bad else observation.command

    world = World()
    cycles, message = world.run("", controller=step, error=ControllerError)
    assert "test_safety.py: step: step() raised" in message
    assert world.has_set_down() and len(cycles) == len(world.sent)


@pytest.mark.parametrize("change", BAD_COMMANDS.values(), ids=BAD_COMMANDS)
def test_whatever_sending_raises_leads_to_the_retreat(change):
    """Values are checked where they are obeyed, too: not every command is a controller's."""
    world = World()
    cycle = ControlCycle.begin(world.rig(), FEELS, Supervisor(PERIOD), Observer())
    cycle.look()
    cycle.feel()
    sent = cycle.send(change(Command(0.05, 4.0, 0.02, "hold")))
    assert cycle.failure is not None and cycle.supervisor.state == "safe"
    assert world.sent == [sent] and sent.lift_height < 0.02  # on its way down, in the same cycle


def test_a_retreat_that_cannot_be_sent_is_the_end():
    world = World()
    world.command = lambda command: 1 / 0  # type: ignore[method-assign]
    cycle = ControlCycle.begin(world.rig(), FEELS, Supervisor(PERIOD), Observer())
    cycle.look()
    cycle.feel()
    cycle.send(Command(0.05, 4.0))
    assert cycle.supervisor.is_over and isinstance(cycle.failure, ZeroDivisionError)


def test_a_notebook_that_cannot_be_written_is_said_once_and_the_grasp_goes_on():
    """What the loop hands to who records, draws or shows is plain; the controller has its own."""
    cyclic: list = [1.0]
    cyclic.append(cyclic)
    strange = {
        "colour": Enum("Colour", ["RED"]).RED,
        "plan": lambda: None,
        "loop": cyclic,
        "many": [0.0] * 100_000,
    }
    told = Listener()
    world = World()
    world.lift = 0.0

    def step(observation):
        is_over = observation.command.memory.get("count", 0) >= 5
        assert not is_over or observation.command.memory["loop"] is cyclic
        count = observation.command.memory.get("count", 0) + 1
        phase = "done" if is_over else "hold"
        return replace(observation.command, phase=phase, memory={"count": count, **strange})

    last = loop.run_loop(
        world.rig(),
        [SimpleNamespace(perceive=lambda image, now, reading=None: OK)],  # type: ignore[list-item]
        SimpleNamespace(path=Path("mine.py"), step=step),  # type: ignore[arg-type]
        time_limit=30.0,
        observer=told,
    )
    assert last.phase == "done"
    assert [cycle.sent.memory for cycle in told.cycles] == [{"count": k + 1} for k in range(6)]
    assert pickle.loads(pickle.dumps(told.cycles[-1].sent)) == told.cycles[-1].sent
    assert [len(noted) for noted in told.noted] == [4] and len(told.messages) == 1
    assert "plan (function)" in told.messages[0]


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
    assert re.search(r"test_safety.py: line \d+: step\(\) did not return", message)
    assert ended.wait(10)  # it was asked to end, and takes no more computing time
    assert world.has_set_down() and len(cycles) == len(world.sent)


def test_a_controllers_module_state_and_its_thread_last_for_the_run():
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
    last = loop.run_loop(
        world.rig(),
        [SimpleNamespace(perceive=lambda image, now, reading=None: OK)],
        controller,  # type: ignore[list-item, arg-type]
        time_limit=30.0,
    )
    assert last.phase == "done" and len(calls) == 5 and len(threads) == 1


@pytest.mark.parametrize("phase", ["done", "abort"])
def test_a_controller_that_ends_with_the_hand_in_the_air(phase):
    world = World()
    controller = SimpleNamespace(
        path=Path("mine.py"), step=lambda o: replace(o.command, phase=phase)
    )
    last = loop.run_loop(
        world.rig(),
        [SimpleNamespace(perceive=lambda image, now, reading=None: OK)],
        controller,  # type: ignore[list-item, arg-type]
        time_limit=30.0,
    )
    assert last.phase == phase and world.has_set_down()


def test_who_is_told_of_a_cycle_and_fails():
    def act():
        raise OSError("no space left")

    world = World()
    cycles, message = world.run("", act=act, error=OSError)
    assert message == "no space left" and world.has_set_down()
    assert len(cycles) == len(world.sent)  # and it is told of every other one


def test_a_chain_that_fails():
    def perceive(image, now, reading=None):
        if image.time > 0.2:
            raise ValueError("singular matrix")
        return OK

    world = World()
    cycles, message = world.run("", perceive=perceive, error=ValueError)
    assert message == "singular matrix" and world.has_set_down()
    assert (
        math.isnan(cycles[-1].touch[0].force_normal)
        and cycles[-1].touch[0].status.code == "no answer"
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


def test_a_controller_cannot_close_blind():
    world = World()
    world.run("camera", controller=lambda o: replace(o.command, opening=0.0, lift_height=1.0))
    at = world.sent[4].opening
    assert all(command.opening >= at for command in world.sent[5:])


def test_a_controller_cannot_exceed_the_limits():
    limits = Limits(opening=(0.01, 0.1), speed=0.1, force=5.0)
    sent = limits.apply(Command(0.5, 99.0, 9.0), Command(0.099, 1.0), 0.05)
    assert (sent.opening, sent.force_limit) == (0.1, 5.0)
    sent = limits.apply(Command(0.0, 1.0), Command(0.05, 1.0), 0.05)
    assert sent.opening == pytest.approx(0.05 - 0.1 * 0.05)


# -- air
# --------------------------------------------------------------------------------

AIR = Limits(pressure=(200.0, 2000.0), pressure_rate=600.0)


@pytest.mark.parametrize(
    ("wanted", "last", "period", "sent"),
    [
        ((1500.0, 900.0), (1000.0, 1000.0), 0.05, (1030.0, 970.0)),  # 600 Pa/s
        ((1500.0,), (1000.0,), 0.1, (1045.0,)),  # what an image may find changed
        ((9000.0, 0.0), (1990.0, 210.0), 0.05, (2000.0, 200.0)),
        (None, (1000.0,), 0.05, None),
    ],
)
def test_air_keeps_range_and_rate(wanted, last, period, sent):
    wanted = Command(0.05, 1.0, pressure_gauge=wanted)
    assert AIR.apply(wanted, Command(0.05, 1.0, pressure_gauge=last), period).pressure_gauge == sent


class Chamber:
    """A valve that does at once what it is told."""

    def __init__(self):
        self.told = []
        self.pressure = 1000.0

    def state(self):
        return ValveState(bool(self.told) and self.told[-1] is not None, self.pressure, 0.0)

    def follow(self, pressure):
        self.told.append(pressure)
        self.pressure = self.pressure if pressure is None else pressure


def run_air(world, valve, step, limits=AIR):
    rig = world.rig()
    rig = replace(rig, fingers=(replace(rig.fingers[0], valve=valve),), limits=limits)
    controller = SimpleNamespace(path=Path("mine.py"), step=step)
    feels = SimpleNamespace(perceive=lambda image, now, reading=None: OK)
    return loop.run_loop(rig, [feels], controller, time_limit=3.0)  # type: ignore[list-item, arg-type]


def test_air_begins_at_what_the_gauge_shows_and_is_sealed_when_it_is_left_alone():
    valve = Chamber()
    world = World()
    world.lift = 0.0

    def step(observation):
        calls = round(observation.time * 30)
        return replace(
            observation.command,
            phase="done" if calls == 9 else "hold",
            pressure_gauge=(600.0,) if 2 <= calls < 6 else None,
        )

    run_air(world, valve, step)
    assert valve.told == pytest.approx([980.0, 960.0, 940.0, 920.0, None])  # 20 Pa a cycle


@pytest.mark.parametrize(
    ("pressures", "limits", "message"),
    [
        ((600.0,), Limits(), "Command: pressure_gauge: rig 'stub' has no valves"),
        ((600.0, 600.0), AIR, "Command: pressure_gauge: 2 pressures for 1 fingers"),
        ((math.nan,), AIR, "nan is not a finite number"),
    ],
)
def test_air_that_a_rig_cannot_give_is_refused_by_name_and_the_hand_goes_down(
    pressures, limits, message
):
    world = World()
    with pytest.raises(InputError, match=message):
        run_air(
            world,
            Chamber(),
            lambda o: replace(o.command, pressure_gauge=pressures) if o.time > 0.2 else o.command,
            limits,
        )
    assert world.has_set_down()


def test_a_blind_rig_keeps_its_air_and_a_retreat_too(supervisor):
    last = replace(LAST, pressure_gauge=(900.0,))
    wanted = replace(LAST, pressure_gauge=(2000.0,))
    assert supervisor.decide(0.1, wanted, last, (BLIND,), ()).pressure_gauge == (900.0,)
    supervisor.make_safe("a fault", 0.2, last)
    assert supervisor.decide(0.3, wanted, last, (OK,), ()).pressure_gauge == (900.0,)


def test_a_valve_that_does_not_obey_leads_to_the_retreat():
    class Broken(Chamber):
        def follow(self, pressure):
            raise DeviceError("valve left is lost")

    world = World()
    with pytest.raises(DeviceError, match="stopped safely: valve left is lost"):
        run_air(world, Broken(), lambda o: replace(o.command, pressure_gauge=(900.0,)))
    assert world.has_set_down()


def test_the_jaws_open_only_when_the_hand_is_down_as_far_as_the_gripper_says(supervisor):
    """A lift that was stopped is behind; one that stays up for a second is kept up by something."""
    supervisor.make_safe("a fault", 0.0, LAST)
    last = LAST
    opened = None
    for step in range(60):
        now = step * PERIOD
        height = max(0.0, 0.02 - 0.01 * now)  # 2 s, where the command takes 0.7 s
        last = supervisor.decide(now, last, last, (), (), height)
        opened = now if opened is None and last.opening > LAST.opening else opened
    assert opened == pytest.approx(0.02 / RETREAT_SPEED + 1.0, abs=2 * PERIOD)


def test_the_jaws_open_at_once_when_the_hand_has_come_down_with_its_command(supervisor):
    supervisor.make_safe("a fault", 0.0, LAST)
    last = LAST
    while last.opening == LAST.opening:
        last = supervisor.decide(0.1, last, last, (), (), last.lift_height)
    assert last.lift_height == 0.0


@pytest.mark.parametrize(
    ("place", "touch", "lands"),
    [
        (0.02, replace(OK, force_normal=0.0, touching=False), True),
        (0.02, OK, False),  # it still holds something
        (0.02, BLIND, False),  # or may
        (0.0, replace(OK, force_normal=0.0, touching=False), False),
    ],
    ids=["empty", "holds", "blind", "no other place"],
)
def test_an_empty_hand_over_the_place_it_was_told_is_not_driven_into_it(
    supervisor, place, touch, lands
):
    rig = SimpleNamespace(told=Told(place_height=place))
    last = Command(0.06, 4.0, 0.025, "done")
    cycle = SimpleNamespace(rig=rig, last=last, touch=(touch,), supervisor=supervisor, now=1.0)
    assert loop._has_landed(cycle) == lands and (supervisor.state == "safe") != lands  # type: ignore[arg-type]
