"""`mjtactile bench gpu`: grasps in MuJoCo Warp: agreement with the CPU, and speed on a GPU.

Without a GPU, agreement is measured on few worlds, and speed is not measured. With one it takes at
most eight minutes, compilation included: after `_LIMIT` seconds no further part starts.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import mjtactile.gym  # noqa: F401  # registers the environment
from benchmarks.gpu.creep import STEPS, creep, creep_lines
from benchmarks.gpu.linear_solver import stop_at_convergence
from benchmarks.gpu.memory import array_memory
from benchmarks.gpu.pairs import NAME, RANDOM, SEED, PairedGrasps, commands_of
from benchmarks.gpu.presses import KINDS, press_objects, press_table
from benchmarks.gpu.tactile_sensor import speeds
from mjtactile.core import platform_support
from mjtactile.core.types import Array

PAIRS = {True: 400, False: 48}
"""Paired episodes of random objects, with and without a GPU."""
BATCH = {True: 400, False: 8}
"""Pairs that are replayed at once."""
PAIRS_FILE = "gpu-pairs.jsonl"
PRESSES = {True: 8, False: 60}
"""Random presses of each kind of object, in a quick run and otherwise."""
WORLDS = (4096, 16384, 1024)
REPEATED = 8
"""Control steps for each random action."""
TOUCHING = 0.02
"""Normal force of a contact, N."""
_LIMIT = 400.0
_TIMED = 260  # control steps, up to the hold
REQUIREMENTS = {
    "control_steps_per_s": 100_000,
    "solutions_per_s": 5_000_000,
    "same_outcome": 0.97,
    "failed_fraction": 1e-3,
    "memory_GB": 4.0,
}


def run(
    out: Path,
    *,
    quick: bool = False,
    pairs: int | None = None,
    notify: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Measure agreement and failures and, on a GPU, speed and memory.

    Args:
        out: Folder of PAIRS_FILE. An interrupted run continues with the pairs that it lacks.
        quick: Two pairs of episodes, and the smallest number of worlds.
        pairs: Number of paired episodes of random objects (None: PAIRS).
        notify: Receiver of progress messages.

    Returns:
        "device", "pairs", "presses", "creep", "failures" and, on a GPU, "speed", "tactile",
        "solutions", elsewhere "memory". "skipped" names the parts for which no time was left.
    """
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    device = wp.get_device()
    start = time.monotonic()
    result: dict[str, Any] = {"device": device.name, "is_gpu": device.is_cuda, "skipped": []}
    processors = platform_support.processors()
    how: dict[str, Any] = {"device": str(device), "file": out / PAIRS_FILE, "workers": processors}
    parts = []
    if device.is_cuda:
        parts = _speed_parts(commands_of("egg"), str(device), quick)

    def paired(name: str, count: int, batch: int) -> dict[str, Any]:
        return PairedGrasps(name, batch=batch, **how).run(count, notify=notify)

    eggs = 2 if quick else 4
    parts.insert(0, ("pairs", lambda: paired("egg", eggs, eggs)))
    if not quick:
        count, batch = pairs or PAIRS[device.is_cuda], BATCH[device.is_cuda]
        parts.insert(2, ("pairs", lambda: paired(RANDOM, count, batch)))
    parts += [
        ("presses", lambda kind=kind: press_objects(kind, PRESSES[quick], str(device)))
        for kind in KINDS
    ]
    parts += [("creep", lambda step=step: creep(step, str(device))) for step in STEPS[quick:]]
    if not device.is_cuda:
        parts.append(_failure_part(4 if quick else 32, 400 if quick else 10**4, str(device)))
        parts.append(("memory", lambda: _memory(WORLDS[-1 if quick else 0], str(device))))
    for name, measure in parts:
        if time.monotonic() > start + _LIMIT and device.is_cuda:
            result["skipped"].append(name)
            continue
        notify(f"gpu: {name}")
        with contextlib.nullcontext() if device.is_cuda else stop_at_convergence():
            result.setdefault(name, []).append(measure())
    result["seconds"] = time.monotonic() - start
    return result


def _speed_parts(
    commands: Array, device: str, quick: bool
) -> list[tuple[str, Callable[[], dict[str, Any]]]]:
    """Return the parts that need a GPU, the most important ones first."""
    worlds = WORLDS[-1:] if quick else WORLDS
    return [
        ("speed", lambda: _speed(worlds[0], commands, device)),
        ("tactile", lambda: speeds(worlds[0], device, 500)),
        ("solutions", lambda: _solutions(8192, device)),
        *(("speed", lambda n=n: _speed(n, commands, device)) for n in worlds[1:]),
        _failure_part(worlds[0], 10**5 if quick else 10**6, device),
        ("solutions", lambda: _solutions(32768, device)),
    ]


def _failure_part(worlds: int, steps: int, device: str) -> tuple[str, Callable[[], dict[str, Any]]]:
    return "failures", lambda: _failures(worlds, steps, device)


def _worlds(count: int, device: str, how: Mapping[str, Any]) -> Any:
    return gymnasium.make_vec(
        NAME, count, vectorization_mode="vector_entry_point", device=device, **how
    )


def _speed(worlds: int, commands: Array, device: str) -> dict[str, Any]:
    """Measure the speed of episodes with the same commands in all worlds.

    No step waits for the host.
    """
    import warp as wp

    before = wp.get_device(device).free_memory
    many = _worlds(worlds, device, {"object": "egg", "randomization": "default"})
    many.reset(seed=SEED)
    rows = [wp.array(np.tile(row, (worlds, 1)), dtype=float, device=device) for row in commands]
    many.step(rows[0])  # compiles and captures
    many.step(rows[0])
    wp.synchronize_device(device)
    memory = before - wp.get_device(device).free_memory
    many.reset(seed=SEED)
    wp.synchronize_device(device)
    start = time.perf_counter()
    for row in rows[:_TIMED]:
        many.step(row)
    wp.synchronize_device(device)
    elapsed = time.perf_counter() - start
    truth = many.unwrapped.truth()
    found = {
        "worlds": worlds,
        "control_steps_per_s": _TIMED * worlds / elapsed,
        "memory_GB": memory / 1e9,
        "held_N": float(truth["force_normal_true_N"].mean()),
        "in_hold": float(np.mean(truth["phase"] == "hold")),
    }
    many.close()
    return found


def _memory(worlds: int, device: str) -> dict[str, Any]:
    """Measure the memory of episodes without a GPU."""

    def make() -> Any:
        many = _worlds(worlds, device, {"object": "egg", "randomization": "default"})
        many.reset(seed=SEED)
        return many

    return {"worlds": worlds, "memory_GB": array_memory(make)}


def _solutions(count: int, device: str) -> dict[str, Any]:
    """Measure the time of warm solutions under a ball that approaches by 42 um per step."""
    import warp as wp

    from mjtactile.warp import Membranes
    from mjtactile.warp.device.obstacles import SPHERE

    membranes: Any = Membranes("dense", count, device=device)
    top = float(membranes.membrane.rest.x[2].max())
    places: list[Any] = []
    for step in range(24):
        geoms = membranes.geoms.numpy().copy()
        geoms["kind"][:, 0], geoms["size"][:, 0, 0] = SPHERE, 0.01
        geoms["p"][:, 0, 2], geoms["R"][:, 0] = 0.01 + top - 42e-6 * step, np.eye(3)
        places.append(wp.array(geoms, dtype=membranes.geoms.dtype, device=device))
    membranes.solve()
    wp.synchronize_device(device)
    start = time.perf_counter()
    for geoms in places:
        wp.copy(membranes.geoms, geoms)
        membranes.solve()
    wp.synchronize_device(device)
    elapsed = time.perf_counter() - start
    return {"membranes": count, "solutions_per_s": len(places) * count / elapsed}


def _failures(worlds: int, steps: int, device: str) -> dict[str, Any]:
    """Count rejected solutions and invalid states under random actions, which squeeze objects.

    Each action is repeated as long as a decision of a learner.
    """
    rng = np.random.default_rng(SEED)
    many = _worlds(worlds, device, {"object": RANDOM, "randomization": "default"})
    many.reset(seed=SEED)
    rounds = max(1, steps // worlds)
    rejected, errors, touching, before = 0, 0, 0, np.zeros(worlds, int)
    for k in range(rounds):
        if k % REPEATED == 0:
            actions = rng.uniform((-1.25, -1, -1), (0.75, 0.2, 1), (worlds, 3)).clip(-1)
        many.step(actions.astype(np.float32))
        truth = many.unwrapped.truth()
        solutions = truth["rejected_solutions"]
        rejected += int((solutions > before).sum())
        errors += int((truth["outcome"] == "error").sum())
        touching += int((truth["force_normal_true_N"] > TOUCHING).any(axis=1).sum())
        before = solutions
    many.close()
    return {
        "control_steps": rounds * worlds,
        "worlds": worlds,
        "touching": touching,
        "rejected": rejected,
        "failed": errors,
        "failed_fraction": (rejected + errors) / (rounds * worlds),
    }


def table(result: Mapping[str, Any]) -> str:
    """Return the tables in Markdown."""
    lines = [
        f"Device: {result['device']}. Commands of `gentle` on the CPU, replayed; "
        '`randomization="default"` without object sizes.',
        "",
        "| object | pairs | held, CPU / device | same outcome, % | mean force in the hold: "
        "difference, median / 95 %, mN |",
        "|---|---|---|---|---|",
    ]
    for row in result["pairs"]:
        median, p95 = row["force_difference_median_N"], row["force_difference_p95_N"]
        forces = "-" if median is None else f"{1e3 * median:.1f} / {1e3 * p95:.1f}"
        lines.append(
            f"| {row['object']} | {row['pairs']} | {row['held_cpu']} / {row['held']} | "
            f"{100 * row['same_outcome']:.0f} | {forces} |"
        )
    if result.get("presses"):
        lines += ["", "Random presses of 0.3 to 2.5 mm, 6 mm from the frame:", ""]
        lines += press_table(result["presses"])
    if result.get("creep"):
        lines += creep_lines(result["creep"])
    for row in result.get("failures", []):
        lines += [
            "",
            f"Random actions in {row['worlds']} worlds, random objects: {row['control_steps']:,} "
            f"control steps, {row['touching']:,} of them with contact; {row['rejected']} with a "
            f"rejected solution, {row['failed']} with an invalid state.",
        ]
    for row in result.get("memory", []):
        lines += ["", f"Arrays of {row['worlds']} worlds: {row['memory_GB']:.2f} GB."]
    if not result["is_gpu"]:
        return "\n".join([*lines, "", "No GPU was at hand: speed was not measured."]) + "\n"
    lines += ["", "| worlds | control steps/s | memory, GB | held force, N |", "|---|---|---|---|"]
    lines += [
        f"| {row['worlds']} | {row['control_steps_per_s']:,.0f} | {row['memory_GB']:.2f} | "
        f"{row['held_N']:.3f} |"
        for row in result.get("speed", [])
    ]
    lines += ["", "| measured | worlds or membranes | result |", "|---|---|---|"]
    for row in result.get("tactile", []):
        lines += [
            f"| gripper and egg with membranes, physics steps/s | {row['worlds']} | "
            f"{row['membranes_steps_per_s']:,.0f} |",
            f"| the same with MuJoCo's `<tactile>` | {row['worlds']} | "
            f"{row['tactile_steps_per_s']:,.0f} |",
        ]
    lines += [
        f"| solutions of membranes alone, 1/s | {row['membranes']} | "
        f"{row['solutions_per_s']:,.0f} |"
        for row in result.get("solutions", [])
    ]
    if result["skipped"]:
        lines += ["", f"Not measured, no time left: {', '.join(result['skipped'])}."]
    return "\n".join(lines) + "\n"
