"""Episode: one grasp of one object with one seed by one controller, and its result line.

A line does not depend on time, machine or number of workers.
"""

from __future__ import annotations

import contextlib
import gc
import math
import shutil
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from mjtactile.core.errors import Interrupted, MjtactileError
from mjtactile.core.fidelity_levels import LEFT_OUT
from mjtactile.core.flags import Flags
from mjtactile.core.scenario import Scenario
from mjtactile.core.task import load_task
from mjtactile.evaluate import emulated
from mjtactile.recording.files import to_json
from mjtactile.recording.observer import Observer
from mjtactile.recording.writer import Recorder
from mjtactile.rig.domain_randomization import sample_world
from mjtactile.rig.file import load_sim_rig
from mjtactile.runtime.controller import LoadedController
from mjtactile.runtime.cycle import Cycle
from mjtactile.runtime.grasp import SET_DOWN, run_grasp
from mjtactile.runtime.session import Session
from mjtactile.sim.devices import SimClock
from mjtactile.sim.scenes.objects import load_object
from mjtactile.sim.scenes.random_objects import object_text as object_text
from mjtactile.sim.scenes.random_objects import random_object, seed_of

STOPPED = ("unsafe", "hung", "raised")
"""Controller failures that end a run early: the supervisor stopped it, a step hung or raised."""
OUTCOMES = ("held", "dropped", "crushed", *STOPPED, "error")
"""Outcomes of an episode. An error (of the simulation, an object) is no failure of a controller."""
RANDOM = "random"
"""Placeholder for an object: a different random one in each episode."""
TASK_MEASURES = (
    *("margin_true", "margin_above_2_true", "margin_ready_true"),
    *("impact_N_s_true", "tilt_deg_true", "release_delay_s_true"),
)
"""Ground-truth measures of a task; null if the task does not have the measure."""
_KEPT = (
    *("outcome", "peak_force_N", "peak_force_true_N", "hold_force_N", "hold_force_true_N"),
    *("slip_mm_true", *TASK_MEASURES, "frames", "reason"),
)


@dataclass(frozen=True)
class Episode:
    """Episode `index` of an evaluation, with one object and seed for every controller."""

    index: int
    scenario: Scenario
    recording: str = ""
    """Folder of the recording; empty: no recording. The result line does not depend on it."""

    @property
    def controller(self) -> str:
        """The controller's name in lines."""
        return Path(self.scenario.controller).stem

    @property
    def name(self) -> str:
        """Name of the stored results, unique within an evaluation."""
        return name_of(self.controller, self.index)


def name_of(controller: str, index: int) -> str:
    return f"{controller}-{index:06d}"


def plan(
    scenario: Scenario,
    count: int,
    controllers: Sequence[str],
    objects: Sequence[str],
    *,
    shard: tuple[int, int] = (1, 1),
) -> list[Episode]:
    """Return the episodes of an evaluation.

    Args:
        scenario: Scenario without controller and object; its seed is the first episode's.
        count: Episodes for each controller.
        controllers: Controllers; all run the same episodes.
        objects: Objects, used in turn; "random" is a random object for each seed.
        shard: (k, n): only the k-th of n parts.

    Returns:
        The episodes in order, each with every controller.
    """
    part, parts = shard
    episodes = []
    for index in range(part - 1, count, parts):
        seed = scenario.seed + index
        name = objects[index % len(objects)]
        grasped = f"{RANDOM}:{seed}" if name == RANDOM else name
        for controller in controllers:
            episode_scenario = replace(scenario, object=grasped, controller=controller, seed=seed)
            episodes.append(Episode(index, episode_scenario))
    return episodes


def run_episode(
    episode: Episode,
    *,
    controller: LoadedController | None = None,
    watching: Sequence[Observer] = (),
) -> dict[str, Any]:
    """Run one episode.

    Args:
        episode: Episode to run.
        controller: Replacement for the controller file of the scenario; the line keeps the file's
            name.
        watching: Observers of the run.

    Returns:
        The result line of the episode. Any failure is recorded as an error of this episode.

    Raises:
        Interrupted: The run was stopped. It has no line and runs when the evaluation is resumed.
    """
    scenario = episode.scenario
    facts = _Facts()
    with _recorder(episode) as recorder:
        observers = [*watching, facts] if recorder is None else [*watching, facts, recorder]
        summary = _run(scenario, observers, controller)
        if summary["outcome"] == "error" and facts.is_crushed:
            summary["outcome"] = "crushed"  # regardless of later events
        if summary["outcome"] == SET_DOWN:
            summary["outcome"] = "dropped"  # not held; the criterion of an evaluation
        if recorder is not None and recorder.cycles:
            recorder.close(outcome=summary["outcome"])
        elif recorder is not None:
            recorder.discard()  # it failed before its start
    # A world occupies megabytes in a few hundred objects with cyclic references; Python would keep
    # dozens of them. Scanning the other objects, mainly modules, takes longer: they are frozen.
    gc.collect()
    _freeze_remaining()
    kept = [key for key in _KEPT if key not in TASK_MEASURES or key in summary]
    line: dict[str, Any] = {
        "episode": episode.index,
        "controller": episode.controller,
        "object": Path(scenario.object).stem.partition(":")[0],
        "seed": scenario.seed,
        **{key: _json(summary.get(key)) for key in kept},
        "time_s": facts.time,
        "phases": " > ".join(facts.phases),
    }
    line |= {name: False for name in LEFT_OUT if summary.get(name) is False}
    return line | {
        "break_force_N": facts.break_force,
        "flags": to_json(facts.flags),
        "randomized": _sampled_values(scenario),
        "rerun_command": scenario.command(),
    }


@cache
def _freeze_remaining() -> None:
    """Freeze once per process, since `gc.get_freeze_count` takes as long as a collection."""
    gc.freeze()


def _sampled_values(scenario: Scenario) -> dict[str, Any]:
    """Return the values sampled by the seed: of a random object, the task, the randomization."""
    seed = seed_of(scenario.object)
    values = {} if seed is None else dict(random_object(seed).values)
    if emulated.check(scenario):
        return values
    file = load_sim_rig(scenario.rig)
    values |= dict(load_task(scenario.task).sample(scenario.seed, len(file.fingers)).values)
    sample = sample_world(scenario.randomization, scenario.seed, scenario.design(), file)
    return values | dict(sample.values)


def _run(
    scenario: Scenario, observers: Sequence[Observer], controller: LoadedController | None
) -> dict[str, Any]:
    """Return the summary of the grasp, or of its error. Raises Interrupted."""
    try:
        if not emulated.check(scenario):
            return run_grasp(scenario, observers, controller=controller, workers=0).summary()
        true = emulated.TrueOutcome(load_object(scenario.object).break_force)
        result = run_grasp(scenario, [true, *observers], controller=controller)
        return true.score(result.summary())
    except Interrupted:
        raise
    except MjtactileError as error:
        return {"outcome": getattr(error, "kind", "error"), "reason": " ".join(str(error).split())}
    except Exception as error:  # noqa: BLE001
        # an internal error in one episode does not end the others
        last = traceback.extract_tb(error.__traceback__)[-1]
        message = f"{type(error).__name__}: {' '.join(str(error).split())}"
        where = f"{Path(last.filename).name}, line {last.lineno}"
        return {"outcome": "error", "reason": f"internal error in {where}: {message}"}


@contextlib.contextmanager
def _recorder(episode: Episode) -> Iterator[Recorder | None]:
    """Open the recording of the episode; it replaces that of an interrupted run."""
    if not episode.recording:
        yield None
        return
    shutil.rmtree(episode.recording, ignore_errors=True)
    with Recorder(episode.recording, episode.scenario.header()) as recorder:
        yield recorder


class _Facts(Observer):
    """Facts of a run: breaking force of the object, phases and duration."""

    sees = False

    def __init__(self) -> None:
        self._start = math.nan
        self.break_force: float | None = None
        self.flags: Flags = {}
        self.phases: list[str] = []
        self.is_crushed = False
        self.time = 0.0
        """Simulated time from the first cycle to the last, s."""

    def start(self, session: Session) -> None:
        """Switch off parallel stepping, since each episode has its own process."""
        if isinstance(session.rig.clock, SimClock):
            session.rig.clock.step_in_turn()

    def note(self, **facts: Any) -> None:
        self.break_force = facts.get("break_force_N", self.break_force)
        self.flags = facts.get("flags", self.flags)

    def add(self, cycle: Cycle, view: Any = None, **truth: Any) -> None:
        self._start = cycle.time if math.isnan(self._start) else self._start
        self.time = cycle.time - self._start
        force = max(truth.get("force_normal_true", [0.0]))
        self.is_crushed |= self.break_force is not None and force > self.break_force
        if self.phases[-1:] != [cycle.sent.phase]:
            self.phases.append(cycle.sent.phase)


def _json(value: Any) -> Any:
    """Return `value`, or None (null) if it is not finite."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
