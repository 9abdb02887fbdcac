"""Paired grasps: commands of the controller `gentle` on the CPU, replayed on a device."""

from __future__ import annotations

import contextlib
import json
import math
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

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
_STEPS = 520  # control steps of an episode
_RATE = 30.0  # control steps per second
_AFTER = (1.0, -0.75, -1.0)  # action after the last command: open


@dataclass(frozen=True, eq=False)
class Grasp:
    """Grasp on the CPU: actions (steps, 3), commanded openings and lift heights (cycles, 2), m,
    mean ground-truth force in the hold, N, and outcome."""

    actions: Array
    commanded: Array
    held_force: float
    outcome: str


class _Commands(Observer):
    """Actions between the commands of a grasp, and ground-truth forces of its hold."""

    def __init__(self) -> None:
        self.actions: list[Array] = []
        self.commanded: list[tuple[float, float]] = []
        self.forces: list[float] = []
        self._last: Command | None = None
        self._time = 0.0

    def add(self, cycle: Cycle, view: Any = None, **truth: Any) -> None:
        sent = cycle.sent
        last = self._last or replace(cycle.last or sent, force_limit=sent.force_limit)
        period = cycle.time - self._time if self.actions else 1 / _RATE
        self._time = cycle.time
        action = action_from_commands(last, sent, period)
        self.actions.append(action)
        self.commanded.append((sent.opening, sent.lift_height))
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
    return Grasp(actions, np.array(commands.commanded[:count]), force, line["outcome"])


def commands_of(name: str) -> Array:
    """Return the actions (steps, 3) of the first grasp of an object."""
    how: Any = {"controller": "gentle", "randomization": "default", "effects": "-mesh,-pipeline"}
    return on_the_cpu(Scenario(object=name, seed=SEED, **how)).actions


@dataclass(frozen=True)
class Pair:
    """Grasp of a seed on the CPU and on the device: outcomes, and mean forces in the hold, N.

    Forces are None for a grasp without a hold.
    """

    object: str
    seed: int
    cpu: str
    device: str
    cpu_force: float | None
    device_force: float | None


class PairedGrasps:
    """Grasps of one object on the CPU and on a device, in batches.

    Each batch is written to `file`. Pairs that it contains are not run again; a new file is needed
    after a change of the code.
    """

    def __init__(self, name: str, device: str, file: Path, *, batch: int, workers: int):
        self._name, self._device, self._file = name, device, file
        self._batch, self._workers = batch, workers
        self._mix = random_mix() if name == RANDOM else ()
        self.done = {pair.seed: pair for pair in _read(file) if pair.object == name}

    def run(
        self, count: int, *, seconds: float = math.inf, notify: Callable[[str], None]
    ) -> dict[str, Any]:
        """Run up to `count` pairs; no batch starts after `seconds` s. Return the agreement."""
        start = time.monotonic()
        first = range(SEED, SEED + count, self._batch)
        missing = [seed for seed in first if not self._has(seed)]
        if not missing:
            return agreement(self._name, list(self.done.values()))
        with tempfile.TemporaryDirectory() as folder:
            randomization = str(_one_size(Path(folder)))
            many = gymnasium.make_vec(
                NAME,
                self._batch,
                vectorization_mode="vector_entry_point",
                autoreset_mode="Disabled",
                device=self._device,
                object=self._name,
                randomization=randomization,
            )
            for seed in missing:
                if time.monotonic() > start + seconds:
                    break
                self._run_batch(many, seed, randomization)
                notify(f"gpu: {len(self.done)} of {count} pairs with {self._name!r}")
            many.close()
        return agreement(self._name, list(self.done.values()))

    def _has(self, first: int) -> bool:
        return all(seed in self.done for seed in range(first, first + self._batch))

    def _run_batch(self, many: Any, first: int, randomization: str) -> None:
        seeds = range(first, first + self._batch)
        scenarios = [self._scenario(seed, randomization) for seed in seeds]
        if self._workers > 1:
            with ProcessPoolExecutor(self._workers) as pool:
                grasps = list(pool.map(on_the_cpu, scenarios))
        else:
            grasps = [on_the_cpu(scenario) for scenario in scenarios]
        outcomes, forces = _replayed(many, grasps, first)
        rows = zip(seeds, grasps, outcomes, forces, strict=True)
        found = [
            Pair(self._name, seed, one.outcome, str(outcome), _known(one.held_force), _known(force))
            for seed, one, outcome, force in rows
        ]
        self.done |= {pair.seed: pair for pair in found}
        with self._file.open("a", encoding="utf-8") as lines:
            lines.writelines("\n" + json.dumps(asdict(pair)) for pair in found)

    def _scenario(self, seed: int, randomization: str) -> Scenario:
        name = self._name
        if name == RANDOM:
            name = f"random:{self._mix[seed % len(self._mix)].seed}"
        return Scenario(
            object=name,
            seed=seed,
            controller="gentle",
            randomization=randomization,
            effects="-mesh,-pipeline",
        )


def agreement(name: str, done: Sequence[Pair]) -> dict[str, Any]:
    """Return the agreement of pairs; `different` are seeds and outcomes of those that differ."""
    difference = np.array(
        [
            abs(pair.device_force - pair.cpu_force)
            for pair in done
            if pair.cpu_force is not None and pair.device_force is not None
        ]
    )
    return {
        "object": name,
        "pairs": len(done),
        "same_outcome": float(np.mean([pair.cpu == pair.device for pair in done])),
        "held_cpu": sum(pair.cpu == "held" for pair in done),
        "held": sum(pair.device == "held" for pair in done),
        "different": [[p.seed, p.cpu, p.device] for p in done if p.cpu != p.device],
        "force_difference_median_N": float(np.median(difference)) if len(difference) else None,
        "force_difference_p95_N": float(np.quantile(difference, 0.95)) if len(difference) else None,
    }


def _read(file: Path) -> list[Pair]:
    """Return the pairs of a file; empty lines and one cut off by an interruption are ignored."""
    if not file.exists():
        return []
    found = []
    for line in file.read_text(encoding="utf-8").splitlines():
        with contextlib.suppress(json.JSONDecodeError):
            found.append(Pair(**json.loads(line)))
    return found


def _known(force: float) -> float | None:
    return float(force) if np.isfinite(force) else None


def _replayed(many: Any, grasps: Sequence[Grasp], first: int) -> tuple[Array, Array]:
    """Return the outcomes (n,) and mean forces in the hold (n,), N, of the same commands.

    Each action leads to the command of the CPU. A world that does not follow it in a cycle, since
    its force is unknown there, follows it in the next one.
    """
    count = len(grasps)
    many.reset(seed=first)
    outcomes, forces = np.full(count, "", object), np.full(count, np.nan)
    for step in range(_STEPS):
        actions = _next_actions(grasps, step, *many.unwrapped.commands())
        _, _, terminated, truncated, _ = many.step(actions)
        is_first = (np.asarray(terminated) | np.asarray(truncated)) & (outcomes == "")
        if is_first.any():
            truth = many.unwrapped.truth()
            outcomes[is_first] = truth["outcome"][is_first]
            forces[is_first] = truth["hold_force_true_N"][is_first]
        if (outcomes != "").all():
            break
    return outcomes, np.where(forces > 0, forces, np.nan)


def _next_actions(
    grasps: Sequence[Grasp], step: int, openings: Array, heights: Array
) -> NDArray[np.float32]:
    """Return the actions (n, 3) from the devices' commanded `openings` and `heights` (n,), m, to
    the commands of the CPU."""
    actions = np.stack([grasp.actions[step] for grasp in grasps]).astype(np.float32)
    for k, one in enumerate(grasps):
        if step < len(one.commanded):
            opening, height = one.commanded[step]
            actions[k, 0] = _RATE * (opening - openings[k]) / OPENING_SPEED
            actions[k, 2] = _RATE * (height - heights[k]) / LIFT_SPEED
    return actions.clip(-1, 1)


def _one_size(folder: Path) -> Path:
    """Write the default randomization without object sizes, which a batch of meshes cannot have."""
    text = resources.find("default", "models/randomization", ".toml").read_text()
    lines = [line for line in text.splitlines() if not line.startswith("size_percent")]
    path = folder / "one_size.toml"
    path.write_text("\n".join(lines) + "\n")
    return path
