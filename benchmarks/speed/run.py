"""`mjtactile bench speed`: simulation speed of two membranes that hold an object.

It runs with and without cameras, and against rigid pads. Physics is given in core time, as ratios
of one run: a shared machine gives no better number. The loop with cameras and perception is given
in wall time, since it must keep up with the clock, together with the machine's load.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cpu_time import core_time
from benchmarks.scenes import rigid_pads
from benchmarks.simulation_cases import HOLD_FORCE, Setting, attempt, core_ms, cost_and_noise
from benchmarks.speed import compare, denormals, sensors
from mjtactile.core.design import load_sensor
from mjtactile.core.scenario import Scenario
from mjtactile.report.figures import new_figure
from mjtactile.runtime.controller import load_controller
from mjtactile.runtime.progress import Progress
from mjtactile.runtime.session import open_session

MESHES = ((9, 7), (11, 9), (13, 11), (17, 13), (21, 17), (25, 21), (31, 25))
TIMESTEPS = (1 / 240, 1 / 180, 1 / 150, 1 / 125)
CAMERA_RATE = 60.0  # Hz
SEED = 0  # seed of the grasp


def run(out: Path, quick: bool = False, against: Path | None = None) -> dict[str, Any]:
    """Measure all parts, and plot speed.png in `out`.

    `against`: another checkout for comparison.
    """
    notify = Progress().message
    compared = (
        {}
        if against is None
        else {"compared": compare.compare(against, quick=quick, notify=notify)}
    )
    physics = [
        _physics(Setting(mesh, timestep), notify)
        for mesh in ((11, 9), (13, 11))
        for timestep in TIMESTEPS
    ]
    growth = _growth(MESHES[:4] if quick else MESHES, notify)
    scenes = [_rigid(name, notify) for name in ("rigid pads", "rigid pads, touch_grid")]
    many = sensors.measure(sensors.COUNTS[:2] if quick else sensors.COUNTS, notify)
    kinds = (
        [("", 0), ("", 2)]
        if quick
        else [(accuracy, n) for accuracy in ("", "realtime") for n in (0, 1, 2)]
    )
    loops = [_loop(accuracy, n, notify) for accuracy, n in kinds]
    result = {
        "physics": physics,
        "growth": growth,
        "rigid": scenes,
        "many": many,
        "loops": loops,
        **compared,
    }
    _plot(result, out)
    return result


def _physics(setting: Setting, notify: Callable[[str], None]) -> dict[str, Any]:
    row = setting.summary() | attempt(lambda: cost_and_noise(setting))
    if "failed" not in row:
        row["real_time_factor"] = 1000 / row["ms_per_s"]
        notify(
            f"{setting.mesh} at {1e3 * setting.timestep:.2f} ms: {row['real_time_factor']:.2f} "
            "x real time"
        )
    return row


def _growth(meshes: tuple[tuple[int, int], ...], notify: Callable[[str], None]) -> dict[str, Any]:
    """Measure the core time of a step over the number of vertices, and the slope in log-log
    axes."""
    rows = [
        _physics(Setting(mesh, 1 / 150), notify) | {"vertices": 2 * mesh[0] * mesh[1]}
        for mesh in meshes
    ]
    good = [row for row in rows if "failed" not in row]
    slope = float(
        np.polyfit(
            np.log([r["vertices"] for r in good]), np.log([r["ms_per_step"] for r in good]), 1
        )[0]
    )
    notify(f"cost grows with vertices ^ {slope:.2f}")
    return {"rows": rows, "exponent": slope}


def _rigid(name: str, notify: Callable[[str], None]) -> dict[str, Any]:
    world = rigid_pads.hold(
        load_sensor("dense"), "egg", 1 / 240, HOLD_FORCE, touch_grid="grid" in name
    )
    ms = core_ms(world.step, 500)
    notify(f"{name}: {1e3 * ms:.0f} us a step")
    return {
        "scene": name,
        "ms_per_step": ms,
        "ms_per_s": ms * 240,
        "real_time_factor": 1000 / (ms * 240),
    }


def _loop(accuracy: str, workers: int, notify: Callable[[str], None]) -> dict[str, Any]:
    """Run a whole grasp at CAMERA_RATE, and measure its wall and core time.

    It is the grasp of `mjtactile grasp` without scoring and recording.

    "held" counts from lifting to setting down: two sensors with sealed gas, friction, the object in
    the air.
    """
    design = load_sensor("dense")
    design = replace(design, camera=replace(design.camera, rate=CAMERA_RATE))
    moments: list[tuple[bool, float, float]] = []  # held, the rig's time, wall time
    scenario = Scenario(sensor=design, seed=SEED, accuracy=accuracy)
    with open_session(scenario, workers=workers) as session:
        clock = session.rig.clock
        session.take_references()
        start = (clock.now(), time.perf_counter())
        core = core_time()
        session.run(
            load_controller("gentle"),
            time_limit=60.0,
            on_cycle=lambda cycle: moments.append(
                (cycle.sent.phase in ("lift", "hold", "lower"), cycle.time, time.perf_counter())
            ),
        )
        simulated = clock.now() - start[0]
        wall = time.perf_counter() - start[1]
        core = core_time() - core
        slow = denormals.count(*session.perceptions, *session.rig.cameras)
    _, first, start = next(moment for moment in moments if moment[0])
    _, last, end = next(moment for moment in reversed(moments) if moment[0])
    row = {
        "accuracy": accuracy or "default",
        "workers": workers,
        "camera_rate_Hz": CAMERA_RATE,
        "real_time_factor": simulated / wall,
        "real_time_factor_held": (last - first) / (end - start),
        "core_ms_per_s": 1e3 * core / simulated,
        "load_average": os.getloadavg()[0],
        "denormals": slow,
    }
    notify(
        f"grasp at {CAMERA_RATE:g} Hz, accuracy {row['accuracy']}, {workers} processes: "
        f"{row['real_time_factor']:.2f} x real "
        f"time, {row['real_time_factor_held']:.2f} while held; load {row['load_average']:.1f}"
    )
    return row


def table(result: dict[str, Any]) -> str:
    """Format the result in Markdown."""
    reference = result["rigid"][0]["ms_per_s"]
    lines = [
        "Two sensors with sealed gas and friction hold an egg. Core time; compare rows of one "
        "run only.",
        "",
        "| scene | step ms | ms per simulated s | x real time | time / time of rigid pads |",
        "|---|---|---|---|---|",
    ]
    for row in result["physics"]:
        name = f"membranes {row['mesh'][0]}x{row['mesh'][1]}"
        lines.append(
            f"| {name} at {row['timestep_ms']:.2f} ms | failed: {row['failed']} | | | |"
            if "failed" in row
            else f"| {name} at {row['timestep_ms']:.2f} ms | {row['ms_per_step']:.2f} | "
            f"{row['ms_per_s']:.0f} | "
            f"{row['real_time_factor']:.2f} | {row['ms_per_s'] / reference:.1f} |"
        )
    lines += [
        f"| {row['scene']} at 4.17 ms | {row['ms_per_step']:.3f} | {row['ms_per_s']:.1f} | "
        f"{row['real_time_factor']:.0f} | {row['ms_per_s'] / reference:.1f} |"
        for row in result["rigid"]
    ]
    lines += [
        "",
        "Cost of a step grows with the number of vertices to the power "
        f"{result['growth']['exponent']:.2f} ({result['growth']['rows'][0]['vertices']} to "
        f"{result['growth']['rows'][-1]['vertices']} vertices).",
        "",
        sensors.table(result["many"]),
        "",
        "Complete grasp of an egg in the control loop: two cameras at 60 Hz, perception; wall "
        "time.",
        "",
        "| accuracy | processes for perception | x real time | while the object is held | core ms "
        "per simulated s |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {row['accuracy']} | {row['workers']} | {row['real_time_factor']:.2f} | "
        f"{row['real_time_factor_held']:.2f} | {row['core_ms_per_s']:.0f} |"
        for row in result["loops"]
    ]
    if slow := sum(row["denormals"] for row in result["loops"]):
        lines += ["", f"Denormal numbers in pipelines and cameras after these grasps: {slow}."]
    if "compared" in result:
        lines += ["", compare.table(result["compared"])]
    return "\n".join(lines) + "\n"


def _plot(result: dict[str, Any], out: Path) -> None:
    if (figure := new_figure("speed.png", (6, 4))) is None:
        return
    axes = figure.add_subplot()
    good = [row for row in result["growth"]["rows"] if "failed" not in row]
    count = np.array([r["vertices"] for r in good])
    ms = np.array([r["ms_per_step"] for r in good])
    axes.loglog(count, ms, "o-", label=f"measured, slope {result['growth']['exponent']:.2f}")
    axes.loglog(count, ms[0] * (count / count[0]) ** 1.2, "k--", lw=0.8, label="slope 1.2")
    axes.set(
        xlabel="vertices of both membranes",
        ylabel="core time of a step [ms]",
        title="two sensors holding an egg, 6.7 ms steps",
    )
    axes.legend()
    axes.grid(alpha=0.3, which="both")
    figure.savefig(out / "speed.png")
