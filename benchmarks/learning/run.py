"""`mjtactile bench learning`: speed of touch at each level of simulation, and its cost in accuracy.

- Environment steps by a fixed policy, in processor time of one core.
- Several environments in threads against one thread, in wall time, with the same policy.
- Episodes of `gentle` at each level with the same seeds: outcomes, hold force, episodes per hour of
  one core.
- Precomputation for a new design.
- Memory of many environments, in a separate process.
"""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import mjtactile.gym
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Array
from mjtactile.evaluate.episodes import Episode, run_episode
from mjtactile.gym.env import GraspEnv
from mjtactile.runtime.progress import Progress

LEVELS = {
    "everything": "auto",
    "without images": "-images",
    "without the sheet's mesh": "-mesh",
    "without mesh and images": "-mesh,-images",
    "without mesh, touch drawn": "-mesh,-pipeline",
}
PAIRED = ("auto", "-mesh", "-mesh,-pipeline")
SAMPLED = "-mesh,-pipeline"
PAIRS, PAIRS_QUICK = 100, 1
EPISODES, EPISODES_QUICK = 4, 1
TOGETHER = 8
MANY = 64
FIRST_SEED = 9000  # first seed of the pairs, not used for fits or tuning
_STEPS, _STEPS_QUICK = 224, 30  # steps of each environment: a grasp and the next reset
_FORCE = 0.6  # grip force of the policy, N

Notify = Callable[[str], None]


def run(
    out: Path, *, quick: bool = False, pairs: int | None = None, notify: Notify | None = None
) -> dict[str, Any]:
    """Measure everything, with `pairs` paired episodes."""
    notify = notify or Progress().message
    speeds = {}
    for name, effects in LEVELS.items():
        notify(f"learning: steps, {name}")
        speeds[name] = _speed(effects, EPISODES_QUICK if quick else EPISODES)
    notify("learning: environments together")
    together = {str(threads): _together(threads, quick) for threads in (1, 2)}
    count = pairs or (PAIRS_QUICK if quick else PAIRS)
    rows = [_pair(FIRST_SEED + k, k, count, notify) for k in range(count)]
    notify("learning: design and memory")
    return {
        "speeds": speeds,
        "together": together,
        "pairs": _sums(rows),
        "rows": rows,
        "condense_s": _condense(),
        "memory_MB": _memory(4 if quick else MANY),
    }


# -- speed


def grip(shown: Array, phase: str) -> Array:
    """Return an action of the fixed policy: close, grip with 0.6 N, lift, hold, set down.

    Args:
        shown: Observation of the environment (30,).
        phase: Phase of the grasp.

    Returns:
        The action (3,).
    """
    minimum = min(shown[2], shown[10])
    if phase == "approach":
        return np.array([-0.5, -0.5, 0.0])
    if phase == "release":
        return np.array([0.5, 0.0, 0.0])
    lift = {"lift": 0.6, "lower": -0.6}.get(phase, 0.6 * (minimum > 0.9 * _FORCE))
    closing = -0.3 if phase == "close" else float(np.clip(minimum - _FORCE, -0.2, 0.2))
    return np.array([closing, 0.0, lift])


def _speed(effects: str, episodes: int) -> dict[str, float]:
    """Measure steps per second of processor time, and processor time of a reset, s."""
    env = GraspEnv(effects=effects)
    steps = 0
    spent = 0.0
    resets = 0.0
    for seed in range(episodes):
        start = time.process_time()
        shown, info = env.reset(seed=seed)
        resets += time.process_time() - start
        over = False
        start = time.process_time()
        while not over:
            shown, _, terminated, truncated, info = env.step(grip(shown, info["phase"]))
            over = terminated or truncated
            steps += 1
        spent += time.process_time() - start
    env.close()
    return {"steps_a_second": steps / spent, "reset_s": resets / episodes}


def _together(threads: int, quick: bool) -> float:
    """Return the steps per second of wall time of all environments, over a whole grasp of each."""
    envs = gymnasium.make_vec(mjtactile.gym.ID, num_envs=TOGETHER, effects=SAMPLED, threads=threads)
    shown, info = envs.reset(seed=0)
    steps = _STEPS_QUICK if quick else _STEPS
    start = time.perf_counter()
    for _ in range(steps):
        pairs = zip(shown, info["phase"], strict=True)
        actions = np.array([grip(*pair) for pair in pairs], np.float32)
        shown, *_, info = envs.step(actions)
    spent = time.perf_counter() - start
    envs.close()
    return TOGETHER * steps / spent


# -- pairs


def _pair(seed: int, number: int, count: int, notify: Notify) -> dict[str, Any]:
    """Run the same episode at three levels."""
    row: dict[str, Any] = {"seed": seed}
    for effects in PAIRED:
        notify(f"learning: episode {number + 1} of {count}, {effects}")
        scenario = Scenario(
            object=f"random:{seed}",
            controller="gentle",
            seed=seed,
            effects=effects,
            randomization="default",
        )
        start = time.process_time()
        line = run_episode(Episode(number, scenario))
        row[effects] = {
            "outcome": line["outcome"],
            "hold_force_N": line["hold_force_true_N"],
            "core_s": time.process_time() - start,
        }
    return row


def _sums(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Compare each cheap level with the full one, and synthetic touch with the quasi-static
    membrane."""
    against = [("-mesh", "auto"), (SAMPLED, "auto"), (SAMPLED, "-mesh")]
    return {
        "count": len(rows),
        "compared": [
            {"level": level, "against": other, **_compare(rows, level, other)}
            for level, other in against
        ],
        "an_hour": {
            level: 3600 * len(rows) / sum(row[level]["core_s"] for row in rows) for level in PAIRED
        },
    }


def _compare(rows: list[dict[str, Any]], level: str, other: str) -> dict[str, Any]:
    same = [row[level]["outcome"] == row[other]["outcome"] for row in rows]
    differences = [
        row[level]["hold_force_N"] - row[other]["hold_force_N"]
        for row in rows
        if row[level]["outcome"] == row[other]["outcome"] == "held"
    ]
    spread = float(np.std(differences, ddof=1)) if len(differences) > 1 else math.nan
    return {
        "same": int(sum(same)),
        "held_both": len(differences),
        "force_mN": 1e3 * float(np.mean(differences)) if differences else math.nan,
        "force_interval_mN": 1e3 * 1.96 * spread / math.sqrt(max(len(differences), 1)),
    }


# -- precomputation


_CONDENSE = """
import time
from mjtactile import QuasistaticMembrane, load_sensor
from mjtactile.quasistatic.incremental import Sticking
from mjtactile.sim.sensor.quasistatic_geoms import QS_GRID
design = load_sensor("dense")
begin = time.process_time()
membrane = QuasistaticMembrane(design, QS_GRID)
assert Sticking(membrane).compliance.size
print(time.process_time() - begin)
"""


def _condense() -> float:
    """Return the processor time, s, to precompute a design's membrane and its sticking contacts.

    No cached result exists.
    """
    return _alone(_CONDENSE)


_MANY = """
import sys
from pathlib import Path
import gymnasium, mjtactile.gym
envs = gymnasium.make_vec(mjtactile.gym.ID, num_envs=int(sys.argv[1]), effects="-mesh,-pipeline")
envs.reset(seed=0)
status = Path("/proc/self/status").read_text().split()
print(float(status[status.index("VmHWM:") + 1]) / 1024)
"""
"""Program that prints its maximum resident memory; `getrusage` would include the parent's."""


def _memory(count: int) -> dict[str, float]:
    """Measure the memory of a process with one and with `count` environments, MB; Linux only."""
    return {"count": count, "one": _alone(_MANY, 1), "many": _alone(_MANY, count)}


def _alone(code: str, *arguments: int) -> float:
    """Run code in a separate process and return the number it prints."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


# -- table


_LABELS = {
    "everything": "complete simulation",
    "without the sheet's mesh": "without mesh",
    "without mesh, touch drawn": "without mesh, sampled touch",
}


def table(result: dict[str, Any]) -> str:
    """Format the result in Markdown."""
    lines = ["| level | `effects` | steps per second of one core | reset, s |", "|---|---|---|---|"]
    lines += [
        f"| {_LABELS.get(name, name)} | `{LEVELS[name]}` | {row['steps_a_second']:.0f} | "
        f"{row['reset_s']:.2f} |"
        for name, row in result["speeds"].items()
    ]
    together = result["together"]
    lines += [
        "",
        f"{TOGETHER} environments with sampled touch in one process: {together['1']:.0f} steps "
        f"per second of wall time in one thread, {together['2']:.0f} in two. Memory of a process: "
        f"{result['memory_MB']['one']:.0f} MB with one environment, "
        f"{result['memory_MB']['many']:.0f} MB with {result['memory_MB']['count']}.",
        "",
        f"{result['pairs']['count']} episodes of random objects (`gentle`, "
        f"`--randomization default`, seeds from {FIRST_SEED}) at three levels:",
        "",
        "| level | reference | same outcome | difference of the grip force, mN (95 %) | episodes "
        "per hour of one core |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| `{row['level']}` | `{row['against']}` | {row['same']} of {result['pairs']['count']} "
        f"| {row['force_mN']:+.1f} ± {row['force_interval_mN']:.1f} "
        f"| {result['pairs']['an_hour'][row['level']]:.0f} |"
        for row in result["pairs"]["compared"]
    ]
    return "\n".join(lines) + "\n"
