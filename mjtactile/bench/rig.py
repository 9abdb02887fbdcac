"""`mjtactile bench rig`: the emulated rig's loop, latency, reaction to every fault, host killed, bad bytes.

The host and the emulator share this computer's processors: with other work beside them the numbers are worse.
"""

from __future__ import annotations

import base64
import pickle
import random
import signal
import statistics
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile import control
from mjtactile.design import SensorDesign, load_sensor
from mjtactile.devices.dynamixel_bus import DynamixelBus
from mjtactile.emulator import protocol2
from mjtactile.emulator.process import EmulatorProcess
from mjtactile.emulator.rig import build_emulated_rig
from mjtactile.errors import DeviceError
from mjtactile.rig import Rig
from mjtactile.rigfile import load_rig_file
from mjtactile.safety import Supervisor
from mjtactile.sensing.pipeline import SensorPipeline
from mjtactile.types import Command, Observation

SENSOR, OBJECT = "paper16", "egg"
FAULTS: dict[str, float] = {
    "frames_stopped": 1, "frames_frozen": 1, "frames_late": 0.4, "frames_dark": 1, "frames_saturated": 1, "servo_overload": 1,
    "servo_overheat": 2, "servo_brown_out": 1, "servo_silent": 2, "servo_unplug": 1, "valve_unplug": 1, "valve_silent": 1,
    "valve_garbage": 1, "puncture": 1}
"""Kind and value of each fault that is injected while the loop runs; a stuck valve is injected before the references."""
_FAULT_CYCLE, _CYCLES_MAX = 12, 150


@dataclass
class _Closing:
    """A controller that closes slowly, and never ends by itself."""

    path: Path = Path("bench")

    def step(self, observation: Observation) -> Command:
        return replace(observation.command, opening=observation.command.opening - 5e-5, force_limit=2.0)


class _Enough(Exception):
    """Ends a run from within `on_cycle`."""


def run(out: Path, *, quick: bool) -> dict[str, Any]:
    """All parts; `quick` injects each fault once instead of 20 times and runs the loop for 10 s instead of 5 min."""
    times, seconds, count = (1, 10.0, 10**5) if quick else (20, 300.0, 10**6)
    design = load_sensor(SENSOR)
    faults = {kind: [_react(design, kind, value, seed) for seed in range(times)] for kind, value in FAULTS.items()}
    return {"loop": _loop(design, seconds), "bus": _bus(design), "faults": {k: _summary(v) for k, v in faults.items()},
            "stuck_valve_refused": [_stuck(design) for _ in range(times)],
            "killed": [_killed(design) for _ in range(times)], "fuzz": _fuzz(count)}


def _session(design: SensorDesign, seed: int = 0) -> tuple[EmulatorProcess, Rig]:
    rig_file = load_rig_file("emulated")
    process = EmulatorProcess(rig_file, design, object_name=OBJECT, seed=seed)
    try:
        return process, build_emulated_rig(rig_file, design, object_name=OBJECT, seed=seed, emulator=process)
    except BaseException:
        process.close()
        raise


def _end(process: EmulatorProcess, rig: Rig) -> None:
    try:
        rig.close()
    except DeviceError:
        pass  # what was unplugged cannot be switched off
    finally:
        process.close()


def _loop(design: SensorDesign, seconds: float) -> dict[str, float]:
    """Rate, jitter, missed cycles, and the time from a picture's capture to the command on the wire."""
    process, rig = _session(design)
    starts, latencies = [], []

    def on_cycle(cycle: control.Cycle) -> None:
        starts.append(cycle.time)
        if cycle.state == "running":
            latencies.append(time.monotonic() - max(image.time for image in cycle.images))
        if cycle.time - starts[0] > seconds:
            raise _Enough

    try:
        pipelines = [SensorPipeline(design) for _ in rig.cameras]
        control.take_references(rig, pipelines)
        control.run(rig, pipelines, _Still(), time_limit=seconds + 60, on_cycle=on_cycle)  # type: ignore[arg-type]
    except _Enough:
        pass
    finally:
        truth = process.truth()
        _end(process, rig)
    intervals = np.diff(starts)
    return {"rate_Hz": float(1 / intervals.mean()), "period_ms": 1e3 * rig.period, "jitter_ms": float(1e3 * intervals.std()),
            "missed_percent": float(100 * (intervals > 1.5 * rig.period).mean()),
            "capture_to_command_median_ms": float(1e3 * np.median(latencies)),
            "capture_to_command_p99_ms": float(1e3 * np.percentile(latencies, 99)),
            "world_lost_s": float(truth["lost"])}


class _Still(_Closing):
    def step(self, observation: Observation) -> Command:
        return observation.command


def _bus(design: SensorDesign) -> dict[str, float]:
    """Round trip of one sync read of all servos."""
    rig_file = load_rig_file("emulated")
    process = EmulatorProcess(rig_file, design, object_name=OBJECT)
    try:
        bus = DynamixelBus(process.endpoints["servo"], reply_timeout=0.1)
        try:
            durations = []
            for _ in range(500):
                start = time.perf_counter()
                bus.read_many([1, 2, 3], 126, 21)
                durations.append(time.perf_counter() - start)
        finally:
            bus.close()
    finally:
        process.close()
    return {"read_3_servos_median_ms": 1e3 * statistics.median(durations),
            "read_3_servos_p99_ms": float(1e3 * np.percentile(durations, 99))}


def _react(design: SensorDesign, kind: str, value: float, seed: int) -> dict[str, Any]:
    """Inject one fault into a running loop; s until the loop had left `running`, and what became of it."""
    process, rig = _session(design, seed)
    supervisor, injected, cycles = Supervisor(rig.period), [0.0], [0]

    def on_cycle(cycle: control.Cycle) -> None:
        cycles[0] += 1
        if cycles[0] == _FAULT_CYCLE:
            injected[0] = time.monotonic()
            process.fault(kind, value)
        if cycles[0] > _CYCLES_MAX:
            raise _Enough

    outcome = "not noticed"
    try:
        pipelines = [SensorPipeline(design) for _ in rig.cameras]
        control.take_references(rig, pipelines)
        control.run(rig, pipelines, _Closing(), time_limit=60, on_cycle=on_cycle, supervisor=supervisor)  # type: ignore[arg-type]
    except _Enough:
        pass
    except DeviceError as error:
        outcome = str(error)
    finally:
        _end(process, rig)
    left = [t.time for t in supervisor.history if t.state in ("holding", "safe", "latched") and t.time >= injected[0] - 0.05]
    return {"safe": bool(left), "reaction_s": max(0.0, left[0] - injected[0]) if left and injected[0] else None,
            "state": supervisor.state, "outcome": outcome}


def _summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    reactions = [r["reaction_s"] for r in runs if r["reaction_s"] is not None]
    return {"times": len(runs), "safe": sum(r["safe"] for r in runs),
            "reaction_median_ms": 1e3 * statistics.median(reactions) if reactions else None,
            "reaction_max_ms": 1e3 * max(reactions) if reactions else None, "outcome": runs[0]["outcome"]}


def _stuck(design: SensorDesign) -> bool:
    """A valve that does not move must be refused by the references or by the valve's own sensor."""
    process, rig = _session(design)
    try:
        process.fault("valve_stuck")
        control.take_references(rig, [SensorPipeline(design) for _ in rig.cameras])
        control.run(rig, [], _Closing(), time_limit=3, on_cycle=lambda cycle: None)  # type: ignore[arg-type]
    except DeviceError:
        return True
    finally:
        _end(process, rig)
    return False


def _killed(design: SensorDesign) -> dict[str, float | None]:
    """SIGKILL for a host that holds; s until the servos stopped and the valves were vented by their own watchdogs."""
    rig_file = load_rig_file("emulated")
    process = EmulatorProcess(rig_file, design, object_name=OBJECT)
    try:
        code = base64.b64encode(pickle.dumps(process.connect(rig_file))).decode()
        host = subprocess.Popen([sys.executable, "-m", "mjtactile.bench.rig", code], stdout=subprocess.PIPE)
        assert host.stdout
        host.stdout.readline()  # it holds now
        host.send_signal(signal.SIGKILL)
        killed = time.monotonic()
        host.wait()
        host.stdout.close()
        time.sleep(1.0)
        truth = process.truth()
    finally:
        process.close()
    stops = [t for t in truth["servo_stop_time"].values() if t is not None]
    return {"servos_stopped_s": max(stops) - killed if len(stops) == len(truth["servo_stop_time"]) else None,
            "valves_vented_s": truth["valve_vent_time"] - killed if truth["valve_vent_time"] else None}


def _hold(code: str) -> None:
    """The host that gets killed: hold at 50 Hz, valves open."""
    from mjtactile.devices.dynamixel import DynamixelGripper
    from mjtactile.devices.valve import connect_valves

    rig_file = pickle.loads(base64.b64decode(code))
    _, valves = connect_valves(rig_file.valves)
    gripper = DynamixelGripper(rig_file.bus, rig_file.gripper, rig_file.lift)
    for valve in valves:
        valve.open(1000.0)
    start = time.monotonic()
    while True:
        state = gripper.state()
        gripper.command(Command(state.opening, 2.0))
        for valve in valves:
            valve.state()
        if start and time.monotonic() - start > 0.5:
            start = 0.0
            sys.stdout.write("holding\n")
            sys.stdout.flush()
        time.sleep(0.02)


def _fuzz(count: int) -> dict[str, int]:
    """Bad bytes into the servo's decoder; how many packets were taken for intact."""
    rng = random.Random(0)
    decoder, packets, intact, fed = protocol2.Decoder(), 0, 0, 0
    while fed < count:
        noise = bytes(rng.choice((0xFF, 0xFF, 0xFD, 0x00, rng.randrange(256))) for _ in range(4096))
        fed += len(noise)
        for packet in decoder.feed(noise):
            packets, intact = packets + 1, intact + packet.intact
    return {"bytes": fed, "packets": packets, "accepted": intact}


def table(result: dict[str, Any]) -> str:
    """The result in Markdown."""
    loop, bus, killed = result["loop"], result["bus"], result["killed"]

    def worst(key: str) -> str:
        values = [k[key] for k in killed]
        return "never" if None in values else f"{1e3 * max(values):.0f} ms"

    lines = ["| what | |", "|---|---|",
             f"| loop | {loop['rate_Hz']:.1f} Hz, jitter {loop['jitter_ms']:.1f} ms, {loop['missed_percent']:.1f} % missed |",
             f"| capture to command | median {loop['capture_to_command_median_ms']:.1f} ms, "
             f"p99 {loop['capture_to_command_p99_ms']:.1f} ms |",
             f"| three servos read | median {bus['read_3_servos_median_ms']:.2f} ms, p99 {bus['read_3_servos_p99_ms']:.2f} ms |",
             f"| host killed | servos stopped after {worst('servos_stopped_s')}, "
             f"valves vented after {worst('valves_vented_s')} |",
             f"| stuck valve refused | {sum(result['stuck_valve_refused'])} of {len(result['stuck_valve_refused'])} |",
             f"| bad bytes | {result['fuzz']['bytes']}, {result['fuzz']['accepted']} packets accepted |", "",
             "| fault | safe | reaction, median / worst | |", "|---|---|---|---|"]
    for kind, row in result["faults"].items():
        times = "-" if row["reaction_max_ms"] is None else f"{row['reaction_median_ms']:.0f} / {row['reaction_max_ms']:.0f} ms"
        lines.append(f"| {kind} | {row['safe']} of {row['times']} | {times} | {row['outcome'][:90]} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    _hold(sys.argv[1])
