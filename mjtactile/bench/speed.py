"""`mjtactile bench speed`: how fast two membranes hold an object, with and without cameras, and against rigid pads.

Everything in one run, core time, ratios: a shared machine gives no better number.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.bench.settings import HOLD_FORCE, Setting, attempt, core_ms, cost_and_noise, held
from mjtactile.design import load_sensor
from mjtactile.progress import Progress
from mjtactile.sensing.pipeline import SensorPipeline
from mjtactile.sim import rigid
from mjtactile.sim.camera import Renderer

MESHES = ((9, 7), (11, 9), (13, 11), (17, 13), (21, 17), (25, 21), (31, 25))
TIMESTEPS = (1 / 240, 1 / 180, 1 / 150, 1 / 125)
CAMERA_RATE = 60.0  # Hz


def run(out: Path, quick: bool = False) -> dict[str, Any]:
    """All parts; draws speed.png into `out`."""
    say = Progress().message
    physics = [_physics(Setting(mesh, timestep), say) for mesh in ((11, 9), (13, 11)) for timestep in TIMESTEPS]
    growth = _growth(MESHES[:4] if quick else MESHES, say)
    scenes = [_rigid(name, say) for name in ("rigid pads", "rigid pads, touch_grid")]
    cameras = [_cameras(Setting(mesh, 1 / 180), say, seconds=0.5 if quick else 2.0) for mesh in ((11, 9), (13, 11))]
    result = {"physics": physics, "growth": growth, "rigid": scenes, "cameras": cameras}
    _plot(result, out, say)
    return result


def _physics(setting: Setting, say: Callable[[str], None]) -> dict[str, Any]:
    row = setting.summary() | attempt(lambda: cost_and_noise(setting))
    if "failed" not in row:
        row["real_time_factor"] = 1000 / row["ms_per_s"]
        say(f"{setting.mesh} at {1e3 * setting.timestep:.2f} ms: {row['real_time_factor']:.2f} x real time")
    return row


def _growth(meshes: tuple[tuple[int, int], ...], say: Callable[[str], None]) -> dict[str, Any]:
    """Core time of a step against the number of vertices; the slope in log-log axes."""
    rows = [_physics(Setting(mesh, 1 / 150), say) | {"vertices": 2 * mesh[0] * mesh[1]} for mesh in meshes]
    good = [row for row in rows if "failed" not in row]
    slope = float(np.polyfit(np.log([r["vertices"] for r in good]), np.log([r["ms_per_step"] for r in good]), 1)[0])
    say(f"cost grows with vertices ^ {slope:.2f}")
    return {"rows": rows, "exponent": slope}


def _rigid(name: str, say: Callable[[str], None]) -> dict[str, Any]:
    world = rigid.hold(load_sensor("dense"), "egg", 1 / 240, HOLD_FORCE, touch_grid="grid" in name)
    ms = core_ms(world.step, 500)
    say(f"{name}: {1e3 * ms:.0f} us a step")
    return {"scene": name, "ms_per_step": ms, "ms_per_s": ms * 240, "real_time_factor": 1000 / (ms * 240)}


def _cameras(setting: Setting, say: Callable[[str], None], seconds: float) -> dict[str, Any]:
    """Physics in one thread, two cameras at 60 Hz and the whole sensing chain in another: wall time."""
    design = load_sensor("dense")
    design = replace(design, camera=replace(design.camera, rate=CAMERA_RATE))
    world = held(setting, design=design)
    renderers = [Renderer(design, seed=i) for i in range(2)]
    pipelines = _referenced(design, renderers)
    steps = round(1 / (CAMERA_RATE * setting.timestep))
    spent = {"camera": 0.0, "perception": 0.0}
    frames = round(seconds * CAMERA_RATE)
    with ThreadPoolExecutor(1) as pool:
        begin, core = time.perf_counter(), time.process_time()
        for _ in range(frames):
            start = time.thread_time()
            poses = [world.marker_poses(i) for i in range(2)]
            now = world.time
            physics = pool.submit(world.step, steps)
            images = [renderer.render(*pose, now) for renderer, pose in zip(renderers, poses, strict=True)]
            seen = time.thread_time()
            for pipeline, image in zip(pipelines, images, strict=True):
                pipeline.perceive(image, now)
            spent["camera"] += seen - start
            spent["perception"] += time.thread_time() - seen
            physics.result()
        wall, core = time.perf_counter() - begin, time.process_time() - core
    simulated = frames / CAMERA_RATE
    row = setting.summary() | {
        "camera_rate_Hz": CAMERA_RATE, "real_time_factor": simulated / wall, "core_ms_per_s": 1e3 * core / simulated,
        "camera_ms_per_s": 1e3 * spent["camera"] / simulated, "perception_ms_per_s": 1e3 * spent["perception"] / simulated}
    # what two cores of its own would take: the longer of the two threads
    alone = row["core_ms_per_s"] - row["camera_ms_per_s"] - row["perception_ms_per_s"]
    row["real_time_factor_two_free_cores"] = 1e3 / max(alone, row["camera_ms_per_s"] + row["perception_ms_per_s"])
    say(f"{setting.mesh} with two cameras at 60 Hz: {row['real_time_factor']:.2f} x real time "
        f"({row['real_time_factor_two_free_cores']:.2f} on two free cores)")
    return row


def _referenced(design: Any, renderers: list[Renderer]) -> list[SensorPipeline]:
    """Pipelines that have seen the flat and the inflated membrane, from a sensor that touches nothing."""
    from mjtactile.sim.press import Indenter, PressWorld

    world = PressWorld(design, Indenter("sphere", 5e-3))
    pipelines = [SensorPipeline(design) for _ in renderers]
    for pressure in (0.0, design.chamber.supply_gauge):
        world.inflate(pressure, seal=pressure > 0)
        for pipeline, renderer in zip(pipelines, renderers, strict=True):
            images = [renderer.render(*world.marker_poses(0), world.time) for _ in range(5)]
            if pressure > 0:
                pipeline.take_rest(images, pressure)
            else:
                pipeline.take_flat(images)
    return pipelines


def table(result: dict[str, Any]) -> str:
    """Markdown."""
    reference = result["rigid"][0]["ms_per_s"]
    lines = ["Two sensors with sealed gas and friction hold an egg. Core time; compare the rows of one run.", "",
             "| scene | step ms | ms per simulated s | x real time | against rigid pads |", "|---|---|---|---|---|"]
    for row in result["physics"]:
        name = f"membranes {row['mesh'][0]}x{row['mesh'][1]}"
        lines.append(f"| {name} at {row['timestep_ms']:.2f} ms | failed: {row['failed']} | | | |" if "failed" in row else
                     f"| {name} at {row['timestep_ms']:.2f} ms | {row['ms_per_step']:.2f} | {row['ms_per_s']:.0f} | "
                     f"{row['real_time_factor']:.2f} | {row['ms_per_s'] / reference:.1f} |")
    lines += [f"| {row['scene']} at 4.17 ms | {row['ms_per_step']:.3f} | {row['ms_per_s']:.1f} | {row['real_time_factor']:.0f} | "
              f"{row['ms_per_s'] / reference:.1f} |" for row in result["rigid"]]
    lines += ["", f"Cost of a step grows with the number of vertices to the power {result['growth']['exponent']:.2f} "
              f"({result['growth']['rows'][0]['vertices']} to {result['growth']['rows'][-1]['vertices']} vertices).", "",
              "| with two cameras at 60 Hz and perception | x real time, as measured | on two free cores | camera ms/s | "
              "perception ms/s |", "|---|---|---|---|---|"]
    lines += [f"| {row['mesh'][0]}x{row['mesh'][1]} at {row['timestep_ms']:.2f} ms | {row['real_time_factor']:.2f} | "
              f"{row['real_time_factor_two_free_cores']:.2f} | {row['camera_ms_per_s']:.0f} | {row['perception_ms_per_s']:.0f} |"
              for row in result["cameras"]]
    return "\n".join(lines) + "\n"


def _plot(result: dict[str, Any], out: Path, say: Callable[[str], None]) -> None:
    try:
        from matplotlib.figure import Figure
    except ImportError:
        say("no plot: matplotlib is not installed (pip install 'mjtactile[plots]')")
        return
    figure = Figure(figsize=(6, 4), dpi=110, layout="constrained")
    axes = figure.add_subplot()
    good = [row for row in result["growth"]["rows"] if "failed" not in row]
    count, ms = np.array([r["vertices"] for r in good]), np.array([r["ms_per_step"] for r in good])
    axes.loglog(count, ms, "o-", label=f"measured, slope {result['growth']['exponent']:.2f}")
    axes.loglog(count, ms[0] * (count / count[0]) ** 1.2, "k--", lw=0.8, label="slope 1.2")
    axes.set(xlabel="vertices of both membranes", ylabel="core time of a step [ms]",
             title="two sensors holding an egg, 6.7 ms steps")
    axes.legend()
    axes.grid(alpha=0.3, which="both")
    figure.savefig(out / "speed.png")
