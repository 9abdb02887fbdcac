"""An episode: one grasp of one object with one seed by one controller, and the line that is kept of
it.

A line holds nothing that depends on when, where or beside what it was run: any number of workers
gives the same lines.
"""

from __future__ import annotations

import contextlib
import gc
import math
import shutil
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mjtactile.core.design import load_sensor
from mjtactile.core.errors import Interrupted, MjtactileError
from mjtactile.recording.writer import Recorder
from mjtactile.rig.file import load_sim_rig
from mjtactile.rig.variation import draw
from mjtactile.run.grasp import GraspOptions, run_grasp
from mjtactile.run.session import Session
from mjtactile.sim.rig import SimClock
from mjtactile.sim.scenes.random_objects import object_text as object_text
from mjtactile.sim.scenes.random_objects import random_thing, seed_of

OUTCOMES = ("held", "dropped", "crushed", "error")
"""An error is an episode that did not come to an end (the simulation failed, the controller raised
or hung): no failure."""
RANDOM = "random"
"""In place of an object: another one each time."""
_KEPT = (
    "outcome",
    "peak_force_N",
    "peak_force_true_N",
    "hold_force_N",
    "hold_force_true_N",
    "slip_mm_true",
    "frames",
    "reason",
)


@dataclass(frozen=True)
class Episode:
    """Number `index` of an evaluation; the same number has the same object and seed for every
    controller."""

    index: int
    controller: str
    object: str
    seed: int
    sensor: str = "dense"
    rig: str = "sim"
    accuracy: str = ""
    effects: str = "auto"
    vary: str = "none"
    recording: str = ""
    """Folder to record it into; no recording without. What its line says does not depend on it."""

    @property
    def name(self) -> str:
        """Of what is kept of it, unique within an evaluation."""
        return name_of(Path(self.controller).stem, self.index)

    def options(self) -> GraspOptions:
        """The grasp that it is."""
        return GraspOptions(
            object=self.object,
            sensor=self.sensor,
            controller=self.controller,
            rig=self.rig,
            seed=self.seed,
            accuracy=self.accuracy,
            effects=self.effects,
            vary=self.vary,
            workers=0,
        )

    def command(self) -> str:
        """How to run it again alone."""
        return self.options().command()


def name_of(controller: str, index: int) -> str:
    return f"{controller}-{index:06d}"


def plan(
    count: int,
    controllers: Sequence[str],
    objects: Sequence[str],
    first_seed: int,
    *,
    shard: tuple[int, int] = (1, 1),
    **manner: str,
) -> list[Episode]:
    """`count` episodes for each controller, objects in turn, seeds from `first_seed` on; of these
    the part that `shard` (k, n) names, the k-th of n."""
    part, parts = shard
    return [
        Episode(
            index,
            controller,
            _of_seed(objects[index % len(objects)], first_seed + index),
            first_seed + index,
            **manner,
        )
        for index in range(count)
        if index % parts == part - 1
        for controller in controllers
    ]


def _of_seed(name: str, seed: int) -> str:
    """The object of an episode: of "random" the one of its seed."""
    return f"{RANDOM}:{seed}" if name == RANDOM else name


def run_episode(episode: Episode) -> dict[str, Any]:
    """The episode's line; whatever fails is an error of this episode. Raises Interrupted where it
    was told to end: then it has no line, and is run when the evaluation goes on."""
    line: dict[str, Any] = {
        "episode": episode.index,
        "controller": Path(episode.controller).stem,
        "object": Path(episode.object).stem.partition(":")[0],
        "seed": episode.seed,
    }
    with _recorder(episode) as recorder:
        notes = _Notes(recorder)
        summary = _run(episode, notes)
        if recorder is not None and recorder.cycles:
            recorder.close(outcome=summary["outcome"])
        elif recorder is not None:
            recorder.discard()  # it failed before it began
    # a world is megabytes in a few hundred objects that know each other: Python would keep dozens
    # of them
    gc.collect()
    values = {key: _json(summary.get(key)) for key in _KEPT} | {
        "time_s": notes.time,
        "phases": " > ".join(notes.phases),
    }
    values |= {} if summary.get("images", True) else {"images": False}
    varied = draw(
        episode.vary, episode.seed, load_sensor(episode.sensor), load_sim_rig(episode.rig)
    ).values
    seed = seed_of(episode.object)
    thing = {} if seed is None else random_thing(seed).values
    return (
        line
        | values
        | {
            "break_force_N": notes.break_force,
            "varied": thing | dict(varied),
            "again": episode.command(),
        }
    )


def _run(episode: Episode, notes: _Notes) -> dict[str, Any]:
    """The grasp's summary, or that of an error. Raises Interrupted."""
    try:
        return run_grasp(
            episode.options(), recorder=notes, progress=notes, on_open=_alone
        ).summary()
    except Interrupted:
        raise
    except MjtactileError as error:
        return {"outcome": "error", "reason": " ".join(str(error).split())}
    except Exception as error:  # noqa: BLE001
        # a mistake of ours in one episode shall not end the others
        last = traceback.extract_tb(error.__traceback__)[-1]
        return {
            "outcome": "error",
            "reason": "internal error in "
            f"{Path(last.filename).name}, line "
            f"{last.lineno}: "
            f"{type(error).__name__}: "
            f"{' '.join(str(error).split())}",
        }


def _alone(session: Session) -> None:
    """Episodes have a process each, and these fill the processors."""
    if isinstance(session.rig.clock, SimClock):
        session.rig.clock.step_in_turn()


@contextlib.contextmanager
def _recorder(episode: Episode) -> Iterator[Recorder | None]:
    """Where the episode is recorded, in place of what an interrupted one left there."""
    if not episode.recording:
        yield None
        return
    shutil.rmtree(episode.recording, ignore_errors=True)
    names = ("object", "sensor", "controller", "rig", "seed")
    with Recorder(
        episode.recording,
        {key: getattr(episode, key) for key in names} | {"command": episode.command()},
    ) as recorder:
        yield recorder


class _Notes:
    """Stands in for a recorder and a progress: keeps at what force the object breaks, which phases
    were gone through, and how long that took; hands all on to `recorder`, if there is one."""

    def __init__(self, recorder: Recorder | None) -> None:
        self._recorder = recorder
        self._begin = math.nan
        self.patience = math.inf
        self.break_force: float | None = None
        self.phases: list[str] = []
        self.time = 0.0
        """s in the simulation, from the first cycle to the last."""

    def note(self, **values: Any) -> None:
        self.break_force = values.get("break_force_N", self.break_force)
        if self._recorder is not None:
            self._recorder.note(**values)

    def add_reference(self, stage: str, images: Any, pressure_gauge: Any) -> None:
        if self._recorder is not None:
            self._recorder.add_reference(stage, images, pressure_gauge)

    def add(self, cycle: Any, **truth: Any) -> None:
        self._begin = cycle.time if math.isnan(self._begin) else self._begin
        self.time = cycle.time - self._begin
        if self._recorder is not None:
            self._recorder.patience = self.patience
            self._recorder.add(cycle, **truth)

    def message(self, text: str) -> None: ...

    def update(self, phase: str, time: float, force: float) -> None:
        if self.phases[-1:] != [phase]:
            self.phases.append(phase)


def _json(value: Any) -> Any:
    """`value` with null for what is not known."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
