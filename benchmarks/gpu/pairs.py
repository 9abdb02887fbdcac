"""Paired grasps: commands of the controller `gentle` on the CPU, replayed on a device."""

from __future__ import annotations

import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from mjtactile import Scenario, action_from_commands
from mjtactile.core import resources
from mjtactile.core.policy import LIFT_SPEED, OPENING_SPEED
from mjtactile.core.types import Array, Command
from mjtactile.evaluate.episodes import Episode, run_episode
from mjtactile.recording.observer import Observer
from mjtactile.runtime.cycle import Cycle
from mjtactile.warp.object_mix import random_mix

NAME = "mjtactile/Grasp-v0"
SEED = 4000
RANDOM = "random"
_STEPS = 520  # of an episode
_AFTER = (1.0, -0.75, -1.0)  # action after the last command: open


@dataclass(frozen=True, eq=False)
class Grasp:
    """Grasp on the CPU: actions (steps, 3), mean ground-truth force in the hold, N, and outcome."""

    actions: Array
    held_force: float
    outcome: str


class _Commands(Observer):
    """Actions between the commands of a grasp, and ground-truth forces of its hold."""

    def __init__(self) -> None:
        self.actions: list[Array] = []
        self.forces: list[float] = []
        self._last: Command | None = None
        self._time = 0.0

    def add(self, cycle: Cycle, view: Any = None, **truth: Any) -> None:
        sent = cycle.sent
        last = self._last or replace(cycle.last or sent, force_limit=sent.force_limit)
        period = cycle.time - self._time if self.actions else 1 / 30
        self._time = cycle.time
        action = action_from_commands(last, sent, period)
        self.actions.append(action)
        limit = last.force_limit if sent.force_limit is None else sent.force_limit
        opening = last.opening + OPENING_SPEED * period * action[0]
        lift = last.lift_height + LIFT_SPEED * period * action[2]
        self._last = Command(float(opening), limit, float(lift))
        if sent.phase == "hold":
            self.forces.append(float(np.mean(truth["force_normal_true"])))


def on_the_cpu(scenario: Scenario) -> Grasp:
    """Run one grasp."""
    commands = _Commands()
    line = run_episode(Episode(0, scenario), watching=[commands])
    actions = np.tile(np.array(_AFTER), (_STEPS, 1))
    count = min(len(commands.actions), _STEPS)
    actions[:count] = commands.actions[:count]
    force = float(np.mean(commands.forces)) if commands.forces else np.nan
    return Grasp(actions, force, line["outcome"])


def pairs(name: str, count: int, device: str, workers: int) -> tuple[dict[str, Any], Array]:
    """Return the agreement of `count` grasps, and the actions (steps, 3) of the first one."""
    mix = random_mix()
    with tempfile.TemporaryDirectory() as folder:
        randomization = str(_one_size(Path(folder)))
        scenarios = [
            Scenario(
                object=f"random:{mix[seed % len(mix)].seed}" if name == RANDOM else name,
                seed=seed,
                controller="gentle",
                randomization=randomization,
                effects="-mesh,-pipeline",
            )
            for seed in range(SEED, SEED + count)
        ]
        with ProcessPoolExecutor(workers) as pool:
            grasps = list(pool.map(on_the_cpu, scenarios))
        outcomes, forces = _replayed(name, grasps, device, randomization)
    there = np.array([grasp.outcome for grasp in grasps])
    difference = np.abs(forces - [grasp.held_force for grasp in grasps])
    difference = difference[np.isfinite(difference)]
    row = {
        "object": name,
        "pairs": count,
        "same_outcome": float(np.mean(outcomes == there)),
        "held_cpu": int((there == "held").sum()),
        "held": int((outcomes == "held").sum()),
        "outcomes": [[str(a), str(b)] for a, b in zip(there, outcomes, strict=True) if a != b],
        "force_difference_median_N": float(np.median(difference)) if len(difference) else None,
        "force_difference_p95_N": float(np.quantile(difference, 0.95)) if len(difference) else None,
    }
    return row, grasps[0].actions


def _replayed(
    name: str, grasps: list[Grasp], device: str, randomization: str
) -> tuple[Array, Array]:
    """Return the outcomes (n,) and mean forces in the hold (n,), N, of the same actions."""
    count = len(grasps)
    many = gymnasium.make_vec(
        NAME,
        count,
        vectorization_mode="vector_entry_point",
        autoreset_mode="Disabled",
        device=device,
        object=name,
        randomization=randomization,
    )
    many.reset(seed=SEED)
    outcomes, forces = np.full(count, "", object), np.full(count, np.nan)
    for step in range(_STEPS):
        actions = np.stack([grasp.actions[step] for grasp in grasps]).astype(np.float32)
        _, _, terminated, truncated, _ = many.step(actions)
        is_first = (np.asarray(terminated) | np.asarray(truncated)) & (outcomes == "")
        if is_first.any():
            truth = many.unwrapped.truth()  # pyright: ignore[reportAttributeAccessIssue]
            outcomes[is_first] = truth["outcome"][is_first]
            forces[is_first] = truth["hold_force_true_N"][is_first]
        if (outcomes != "").all():
            break
    many.close()
    return outcomes, np.where(forces > 0, forces, np.nan)


def _one_size(folder: Path) -> Path:
    """Write the default randomization without object sizes, which a batch of meshes cannot have."""
    text = resources.find("default", "models/randomization", ".toml").read_text()
    lines = [line for line in text.splitlines() if not line.startswith("size_percent")]
    path = folder / "one_size.toml"
    path.write_text("\n".join(lines) + "\n")
    return path
