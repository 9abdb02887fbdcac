"""`mjtactile bench gpu`: grasps in MuJoCo Warp: agreement with the CPU, and speed on a GPU.

Without a GPU, agreement is measured on few worlds, and speed is not measured. With one it takes
about eight minutes, compilation included.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import mjtactile.gym  # noqa: F401  # registers the environment
from mjtactile.core.types import Array

NAME = "mjtactile/Grasp-v0"
OBJECTS = ("egg", "block", "vial")
_FORCE = 0.8  # goal of the commands, N
_STEPS = 190  # of an episode, s / period
_SEED = 4000
PAIRS = {True: 400, False: 6}
"""Paired episodes, with and without a GPU."""
WORLDS = (1024, 4096, 16384)
ASKED = {
    "control_steps_per_s": 100_000,
    "solutions_per_s": 5_000_000,
    "same_outcome": 0.97,
    "failed_fraction": 1e-3,
    "memory_GB": 4.0,
}


def run(
    out: Path, *, quick: bool = False, notify: Callable[[str], None] = lambda _: None
) -> dict[str, Any]:
    """Measure agreement and, on a GPU, speed, memory and failures.

    Args:
        out: Folder, unused.
        quick: Two pairs of episodes, and the smallest number of worlds.
        notify: Receiver of progress messages.

    Returns:
        "device", "pairs" and, on a GPU, "speed", "solutions" and "failures".
    """
    import warp as wp

    wp.config.quiet = True
    device = wp.get_device()
    result: dict[str, Any] = {"device": device.name, "is_gpu": device.is_cuda, "pairs": []}
    count = 2 if quick else PAIRS[device.is_cuda] // len(OBJECTS)
    commands: dict[str, Array] = {}
    for name in OBJECTS[: 1 if quick else None]:
        notify(f"gpu: {count} pairs of episodes with {name!r}")
        row, commands[name] = _pairs(name, count, str(device))
        result["pairs"].append(row)
    if device.is_cuda:
        worlds = WORLDS[: 1 if quick else None]
        result["speed"] = []
        for number in worlds:
            notify(f"gpu: speed of {number} worlds")
            result["speed"].append(_speed(number, commands["egg"], str(device)))
        notify("gpu: solutions of membranes alone")
        result["solutions"] = [_solutions(number, str(device)) for number in (8192, 32768)]
        notify("gpu: random actions")
        result["failures"] = _failures(worlds[-1], 10**5 if quick else 10**6, str(device))
    return result


def _actions(observation: Array) -> Array:
    """Close, regulate the force, lift, hold and set down: actions (n, 3)."""
    phase = observation[:, 23:30].argmax(axis=1)
    force = observation[:, [2, 10]].mean(axis=1)
    actions = np.full((len(observation), 3), -0.75, np.float32)
    regulated = np.clip(-0.5 * (_FORCE - force), -1, 1)
    actions[:, 0] = np.select([phase <= 1, phase == 6], [-0.8, 1.0], regulated)
    rises = ((phase == 2) & (force > 0.75 * _FORCE)) | (phase == 3) | (phase == 4)
    actions[:, 2] = np.where(rises, 1.0, -1.0)
    return actions


def _pairs(name: str, count: int, device: str) -> tuple[dict[str, Any], Array]:
    """Return the agreement of paired episodes, and the commands (steps, 3) of the first one."""
    how: dict[str, Any] = {"object": name, "randomization": "default"}
    episodes = [_on_the_cpu(_SEED + k, how) for k in range(count)]
    many = _worlds(count, device, how)
    many.reset(seed=_SEED)
    outcomes = np.full(count, "", object)
    forces = np.full((count, _STEPS), np.nan)
    for step in range(_STEPS):
        _, _, terminated, truncated, _ = many.step(np.stack([e["actions"][step] for e in episodes]))
        truth = many.unwrapped.truth()
        is_first = (np.asarray(terminated) | np.asarray(truncated)) & (outcomes == "")
        outcomes[is_first] = truth["outcome"][is_first]
        is_held = (truth["phase"] == "hold") & (outcomes == "")
        forces[is_held, step] = truth["force_normal_true_N"][is_held].mean(axis=1)
    many.close()
    there = np.stack([e["forces"] for e in episodes])
    both = np.isfinite(forces) & np.isfinite(there)
    difference = np.abs(forces - there)[both]
    row = {
        "object": name,
        "pairs": count,
        "same_outcome": float(np.mean(outcomes == [e["outcome"] for e in episodes])),
        "held_cpu": sum(e["outcome"] == "held" for e in episodes),
        "held": int((outcomes == "held").sum()),
        "force_difference_median_N": float(np.median(difference)) if both.any() else None,
        "force_difference_p95_N": float(np.quantile(difference, 0.95)) if both.any() else None,
    }
    return row, episodes[0]["actions"]


def _on_the_cpu(seed: int, how: Mapping[str, Any]) -> dict[str, Any]:
    """Run an episode; return its actions, true force in the hold, and outcome."""
    env = gymnasium.make(NAME, effects="-mesh,-pipeline", **how)
    observation, _ = env.reset(seed=seed)
    actions, forces = np.zeros((_STEPS, 3), np.float32), np.full(_STEPS, np.nan)
    outcome = ""
    for step in range(_STEPS):
        actions[step] = _actions(observation[None])[0]
        observation, _, terminated, truncated, info = env.step(actions[step])
        if info["phase"] == "hold":
            forces[step] = info["force_normal_true_N"].mean()
        if terminated or truncated:
            outcome = info["outcome"]
            actions[step + 1 :] = [1.0, -0.75, -1.0]
            break
    env.close()
    return {"actions": actions, "forces": forces, "outcome": outcome}


def _worlds(count: int, device: str, how: Mapping[str, Any]) -> Any:
    return gymnasium.make_vec(
        NAME, count, vectorization_mode="vector_entry_point", device=device, **how
    )


def _speed(worlds: int, commands: Array, device: str) -> dict[str, Any]:
    """Time episodes with the same commands in all worlds; nothing waits for the host."""
    import warp as wp

    before = wp.get_device(device).free_memory
    many = _worlds(worlds, device, {"object": "egg", "randomization": "default"})
    many.reset(seed=_SEED)
    rows = [wp.array(np.tile(row, (worlds, 1)), dtype=float, device=device) for row in commands]
    many.step(rows[0])  # compiles and captures
    many.step(rows[0])
    wp.synchronize_device(device)
    memory = before - wp.get_device(device).free_memory
    many.reset(seed=_SEED)
    wp.synchronize_device(device)
    start = time.perf_counter()
    for row in rows[:120]:
        many.step(row)
    wp.synchronize_device(device)
    elapsed = time.perf_counter() - start
    truth = many.unwrapped.truth()
    found = {
        "worlds": worlds,
        "control_steps_per_s": 120 * worlds / elapsed,
        "memory_GB": memory / 1e9,
        "held_N": float(truth["force_normal_true_N"].mean()),
        "in_hold": float(np.mean(truth["phase"] == "hold")),
    }
    many.close()
    return found


def _solutions(count: int, device: str) -> dict[str, Any]:
    """Time warm solutions under a ball that approaches by 42 um a step."""
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
    """Count the worlds with a rejected solution or an invalid state under random actions."""
    rng = np.random.default_rng(_SEED)
    many = _worlds(worlds, device, {"object": "egg", "randomization": "default"})
    many.reset(seed=_SEED)
    rounds = max(1, steps // worlds)
    rejected, errors = np.zeros(worlds, bool), 0
    for _ in range(rounds):
        many.step(rng.uniform(-1, 1, (worlds, 3)).astype(np.float32))
        truth = many.unwrapped.truth()
        rejected |= truth["rejected_solutions"] > 0
        errors += int((truth["outcome"] == "error").sum())
    many.close()
    return {
        "control_steps": rounds * worlds,
        "worlds": worlds,
        "with_rejected_solutions": int(rejected.sum()),
        "failed": errors,
        "failed_fraction": errors / (rounds * worlds),
    }


def table(result: Mapping[str, Any]) -> str:
    """Return the tables in Markdown."""
    lines = [
        f"Device: {result['device']}. Commands of the environment on the CPU, replayed; "
        '`randomization="default"`.',
        "",
        "| object | pairs | held, CPU / device | same outcome, % | force in the hold: difference, "
        "median / 95 %, mN |",
        "|---|---|---|---|---|",
    ]
    for row in result["pairs"]:
        median, p95 = row["force_difference_median_N"], row["force_difference_p95_N"]
        forces = "-" if median is None else f"{1e3 * median:.1f} / {1e3 * p95:.1f}"
        lines.append(
            f"| {row['object']} | {row['pairs']} | {row['held_cpu']} / {row['held']} | "
            f"{100 * row['same_outcome']:.0f} | {forces} |"
        )
    if not result["is_gpu"]:
        return "\n".join([*lines, "", "No GPU was at hand: speed was not measured."]) + "\n"
    lines += ["", "| worlds | control steps/s | memory, GB | held force, N |", "|---|---|---|---|"]
    lines += [
        f"| {row['worlds']} | {row['control_steps_per_s']:,.0f} | {row['memory_GB']:.2f} | "
        f"{row['held_N']:.3f} |"
        for row in result["speed"]
    ]
    lines += ["", "| membranes | solutions/s |", "|---|---|"]
    lines += [
        f"| {row['membranes']} | {row['solutions_per_s']:,.0f} |" for row in result["solutions"]
    ]
    found = result["failures"]
    lines += [
        "",
        f"Random actions: {found['failed']} invalid states in {found['control_steps']:,} control "
        f"steps; rejected solutions in {found['with_rejected_solutions']} of {found['worlds']} "
        "worlds.",
    ]
    return "\n".join(lines) + "\n"
