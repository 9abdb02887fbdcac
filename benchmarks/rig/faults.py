"""Faults of docs/how-to/hardware.md in a running loop, a killed host, and simulation against
emulation."""

from __future__ import annotations

import base64
import contextlib
import logging
import math
import pickle
import signal
import subprocess
import sys
from typing import Any

from benchmarks.rig.session import OBJECT, Bench, Closing, EndOfRun, design_at, drive
from mjtactile.core import scaled_clock
from mjtactile.core.errors import DeviceError
from mjtactile.core.types import Command
from mjtactile.runtime.cycle import Cycle
from mjtactile.runtime.session import Session
from mjtactile.runtime.supervisor import Supervisor

FAULTS: dict[str, float] = {
    "frames_stopped": 1,
    "frames_frozen": 1,
    "frames_late": 0.4,
    "frames_dark": 1,
    "frames_saturated": 1,
    "servo_overload": 1,
    "servo_overheat": 2,
    "servo_brown_out": 1,
    "servo_silent": 2,
    "servo_unplug": 1,
    "valve_unplug": 1,
    "valve_silent": 1,
    "valve_garbage": 1,
    "valve_sensor": 1,
    "valve_restart": 1,
    "puncture": 1,
}
"""Kind and value of each fault that is injected while the loop runs; a stuck valve is injected
before the references."""
LASTING = ("servo_overload", "servo_overheat", "servo_brown_out", "servo_unplug", "valve_unplug")
"""Faults from which an emulator recovers only after a power cycle."""
# cycle of the injection; time limit, s, for the loop's reaction
_FAULT_CYCLE = 12
_WATCH = 3.0


class Stopwatch(Supervisor):
    """Supervisor that records the actual times of its transitions.

    A transition itself has the start time of its cycle.
    """

    def __init__(self, period: float):
        super().__init__(period)
        self.entered: list[tuple[float, str]] = []

    def _enter(self, state: str, reason: str, now: float) -> None:
        super()._enter(state, reason, now)
        self.entered.append((scaled_clock.monotonic(), state))

    def reaction(self, injected: float) -> float | None:
        """Return the time, s, from a fault at `injected` until the loop left "running".

        Return None if it did not leave it, or if there was no fault (0).
        """
        left = [
            at
            for at, state in self.entered
            if state in ("holding", "safe", "latched") and at >= injected > 0
        ]
        return left[0] - injected if left else None


class KeptBench:
    """An emulator that is reused from one fault to the next, until a fault ends it."""

    def __init__(self, name: str, rate: float) -> None:
        self._name = name
        self._rate = rate
        self._bench: Bench | None = None
        # an unplugged device cannot be switched off: the warning would repeat 100 times
        logging.getLogger("mjtactile").setLevel(logging.CRITICAL)

    def bench(self) -> Bench:
        self._bench = self._bench or Bench(self._name, design_at(self._rate))
        return self._bench

    def recover(self, kind: str) -> None:
        """End a fault of that kind, or the emulator, if it does not recover.

        The next call of `bench` then starts a new one.
        """
        if kind in LASTING:
            self.close()
        else:
            self.bench().process.fault(kind, 0)
            scaled_clock.sleep(0.3)

    def close(self) -> None:
        if self._bench is not None:
            self._bench.close()
            self._bench = None

    def end(self) -> None:
        self.close()
        logging.getLogger("mjtactile").setLevel(logging.NOTSET)


class FaultBench(KeptBench):
    """An emulator into which faults are injected in turn."""

    def __init__(self) -> None:
        super().__init__("emulated", 30.0)

    def react(self, kind: str, value: float) -> dict[str, Any]:
        """Inject one fault; return the time, s, until the loop left `running`, and the outcome."""
        bench = self.bench()
        supervisor = Stopwatch(1 / 30)
        injected = [0.0]
        cycles = [0]

        def on_cycle(cycle: Cycle) -> None:
            cycles[0] += cycle.state == "running" or injected[0] > 0
            if cycles[0] == _FAULT_CYCLE and not injected[0]:
                injected[0] = scaled_clock.monotonic()
                bench.process.fault(kind, value)
            if injected[0] and scaled_clock.monotonic() - injected[0] > _WATCH:
                raise EndOfRun

        outcome = drive(bench, Closing(), on_cycle, supervisor=supervisor)
        self.recover(kind)
        reaction = supervisor.reaction(injected[0])
        return {
            "safe": reaction is not None,
            "reaction_s": reaction,
            "state": supervisor.state,
            "outcome": outcome or supervisor.reason,
        }


def stuck() -> dict[str, Any]:
    """Check that the references or the valve's own sensor refuse a stuck valve."""
    bench = Bench("emulated", design_at(30.0))
    rig = bench.connect()
    try:
        bench.process.fault("valve_stuck")
        Session(rig).take_references()
        rig.clock.wait_until(rig.clock.now() + 2.0)
        for valve in rig.valves:
            valve.state()
    except DeviceError as error:
        return {"safe": True, "outcome": str(error)}
    finally:
        with contextlib.suppress(DeviceError):
            rig.close()
        bench.close()
    return {"safe": False, "outcome": "not noticed"}


DEAD: dict[str, dict[str, object]] = {
    "brake": {},
    "limp": {"watchdog": "limp"},
    "goes on": {"servo_firmware": 51},
}
"""Watchdog reactions of the servos after the host is killed (decision 19), and the emulator
settings for each."""
# grip force at which the host holds, N, from the servos' current; closing speed, m/s
_SQUEEZE = 1.0
_SQUEEZE_SPEED = 0.02


def killed(kind: str) -> dict[str, Any]:
    """Kill a host (SIGKILL) that squeezes an egg.

    Return the times, s, until its servos' watchdogs tripped and its valves were vented. Return also
    the contact force on the membranes before and a second after, N.
    """
    bench = Bench("emulated", design_at(30.0), emulator=DEAD[kind])
    try:
        code = base64.b64encode(pickle.dumps(bench.process.connect(bench.rig_file))).decode()
        host = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.rig.faults", code], stdout=subprocess.PIPE
        )
        assert host.stdout
        if not host.stdout.readline():
            raise DeviceError(
                "the host that was to be killed ended by itself: what it printed to stderr says why"
            )
        before = bench.process.truth()
        host.send_signal(signal.SIGKILL)
        at = scaled_clock.monotonic()
        host.wait()
        host.stdout.close()
        scaled_clock.sleep(1.0)
        truth = bench.process.truth()
    finally:
        bench.close()
    stops = [t for t in truth["servo_stop_time"].values() if t is not None]
    return {
        "kind": kind,
        "servos_stopped_s": max(stops) - at
        if len(stops) == len(truth["servo_stop_time"])
        else None,
        "valves_vented_s": truth["valve_vent_time"] - at if truth["valve_vent_time"] else None,
        "squeeze_before_N": max(before["contact_1"], before["contact_2"]),
        "squeeze_after_N": max(truth["contact_1"], truth["contact_2"]),
        "closed_by_mm": 1e3 * (before["opening"] - truth["opening"]),
    }


def _hold(code: str) -> None:
    """Run the host that gets killed: inflate, close on the object, hold at 50 Hz."""
    from mjtactile.devices.dynamixel.gripper import DynamixelGripper
    from mjtactile.devices.valve.driver import connect_valves

    rig_file = pickle.loads(base64.b64decode(code))
    _, valves = connect_valves(rig_file.valves)
    gripper = DynamixelGripper(rig_file.bus, rig_file.gripper, rig_file.lift)
    for valve in valves:
        valve.open(1000.0)
    for valve in valves:
        valve.close()
    opening = gripper.state().opening
    squeezed = 0.0
    while True:
        state = gripper.state()
        for valve in valves:
            valve.state()
        if not squeezed:
            opening -= 0.02 * _SQUEEZE_SPEED
            squeezed = scaled_clock.monotonic() if state.effort > _SQUEEZE else 0.0
        elif scaled_clock.monotonic() - squeezed > 1.0:
            squeezed = math.inf
            sys.stdout.write("holding\n")
            sys.stdout.flush()
        gripper.command(Command(opening, 4.0))
        scaled_clock.sleep(0.02)


def outcome(seed: int) -> dict[str, Any]:
    """Compare the same grasp on both rigs.

    Return the outcome, the estimated hold force and the drive force of the jaws, N. In simulation
    the latter is the joint force; emulated, it follows from the servos' current.
    """
    import tempfile

    import numpy as np

    from mjtactile.core.scenario import Scenario
    from mjtactile.recording.reader import load_recording
    from mjtactile.recording.writer import Recorder
    from mjtactile.runtime.grasp import run_grasp

    result: dict[str, Any] = {"seed": seed}
    for rig in ("sim", "emulated"):
        try:
            scenario = Scenario(object=OBJECT, controller="gentle", rig=rig, seed=seed)
            with tempfile.TemporaryDirectory() as folder:
                with Recorder(folder, {}, frames=False) as recorder:
                    summary = run_grasp(scenario, [recorder]).summary()
                recording = load_recording(folder)
            holding = recording.columns["phase"] == "hold"
            drive = (
                float(np.mean(recording.column("effort", 1)[holding])) if holding.any() else None
            )
            result[rig] = {
                key: summary[key] for key in ("outcome", "hold_force_N", "peak_force_N")
            } | {"hold_drive_N": drive}
        except DeviceError as error:
            unknown = dict.fromkeys(("hold_force_N", "peak_force_N", "hold_drive_N"))
            result[rig] = {"outcome": "fault", "error": str(error)} | unknown
    return result


if __name__ == "__main__":
    _hold(sys.argv[1])
