"""The main job: references, grasp, score. It joins the control loop, which knows no truth, to scoring, which does."""

from __future__ import annotations

import math
import time as wall
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mjtactile.control import Cycle, run, take_references
from mjtactile.controller import load_controller
from mjtactile.design import load_sensor
from mjtactile.errors import InputError
from mjtactile.parallel import Workers, default_workers
from mjtactile.recording import FINGERS
from mjtactile.rig import Rig, build_rig
from mjtactile.types import Image

TIME_LIMIT = 60.0  # s on the rig's clock; a gentle grasp takes about 10


@dataclass(frozen=True)
class GraspOptions:
    """What to grasp, with what: shipped names or files, the rig, and the seed of placement and noise. `workers` processes
    look at the images (None: as many as are worth it here); the result is the same with any number of them."""

    object: str = "egg"
    sensor: str = "dense"
    controller: str = "gentle"
    rig: str = "sim"
    seed: int = 0
    accuracy: str = ""
    effects: str = "auto"
    error_estimate: bool = False
    workers: int | None = None


class RecorderLike(Protocol):
    def note(self, **values: Any) -> None: ...
    def add_reference(self, stage: str, images: list[list[Image]], pressure_gauge: list[float | None]) -> None: ...
    def add(self, cycle: Cycle, **truth: Any) -> None: ...


class ProgressLike(Protocol):
    def message(self, text: str) -> None: ...
    def update(self, phase: str, time: float, force: float) -> None: ...


@dataclass(frozen=True)
class GraspResult:
    """Outcome of a grasp; forces in N on one finger, `slip` m. `milliseconds` are means of wall time per control cycle for
    camera, perception, controller and the rest (in simulation: waiting for the world, which steps and draws meanwhile);
    `perception_median` is a median."""

    options: GraspOptions
    outcome: str
    peak_force: float
    peak_force_true: float
    hold_force: float
    hold_force_true: float
    slip_true: float
    real_time_factor: float
    frames: int
    milliseconds: dict[str, float]
    force_error_estimate: float | None = None

    def summary(self) -> dict[str, Any]:
        """The JSON object of `mjtactile grasp --json`; what is unknown is NaN here and null there."""
        names = {key: Path(getattr(self.options, key)).stem for key in ("object", "sensor", "controller")}
        return {"outcome": self.outcome, "peak_force_N": self.peak_force, "peak_force_true_N": self.peak_force_true,
                "hold_force_N": self.hold_force, "hold_force_true_N": self.hold_force_true,
                "slip_mm_true": 1e3 * self.slip_true, "real_time_factor": self.real_time_factor, "frames": self.frames,
                "perception_ms_median": self.milliseconds["perception_median"], **names, "seed": self.options.seed,
                **({} if self.force_error_estimate is None else {"force_error_estimate_N": self.force_error_estimate})}


@dataclass
class _Log:
    """What the loop says, cycle by cycle, for the result."""

    forces: list[tuple[float, ...]] = field(default_factory=list)
    phases: list[str] = field(default_factory=list)
    milliseconds: dict[str, list[float]] = field(default_factory=lambda: {"camera": [], "perception": [], "controller": []})

    def add(self, cycle: Cycle) -> None:
        self.forces.append(tuple(touch.force_normal for touch in cycle.touch))
        self.phases.append(cycle.sent.phase)
        for part, values in self.milliseconds.items():
            values.append(getattr(cycle, f"{part}_ms"))

    def hold_force(self) -> float:
        held = [force for force, phase in zip(self.forces, self.phases, strict=True) if phase == "hold"]
        return float(np.nanmean(held)) if np.isfinite(held).any() else math.nan

    def peak_force(self) -> float:
        return float(np.nanmax(self.forces)) if np.isfinite(self.forces).any() else math.nan


def run_grasp(options: GraspOptions, *, recorder: RecorderLike, progress: ProgressLike) -> GraspResult:
    """Run one grasp on the rig that `options` names.

    Raises InputError for bad files or names, ControllerError, DeviceError, SimulationError; the rig is brought to its
    safe state on every way out.
    """
    design, controller = load_sensor(options.sensor), load_controller(options.controller)
    with Workers(default_workers() if options.workers is None else options.workers) as workers:  # they start meanwhile
        rig = build_rig(options.rig, design, object_name=options.object, seed=options.seed, accuracy=options.accuracy,
                        effects=options.effects)
        try:
            pipelines = workers.chains(rig.design, FINGERS[:len(rig.cameras)])
            score = _watch(rig, recorder)
            take_references(rig, pipelines, progress.message, recorder.add_reference)
            log = _Log()
            estimate = _estimate(options, rig)

            def on_images() -> None:
                if score is not None:
                    score.snapshot()
                if estimate is not None and log.phases and log.phases[-1] == "hold":
                    estimate.keep()

            def on_cycle(cycle: Cycle) -> None:
                log.add(cycle)
                recorder.add(cycle, **({} if score is None else score.columns(cycle.touch, cycle.sent.phase)))
                progress.update(cycle.sent.phase, cycle.time, float(np.mean(log.forces[-1])))

            begin, start = wall.perf_counter(), rig.clock.now()
            last = run(rig, pipelines, controller, time_limit=TIME_LIMIT, on_cycle=on_cycle, on_images=on_images)
            factor = (rig.clock.now() - start) / (wall.perf_counter() - begin)
        finally:
            rig.close()
    result = _result(options, log, score, factor, completed=last.phase == "done", period=rig.period)
    return result if estimate is None else replace(result, force_error_estimate=estimate.force_error())


def _estimate(options: GraspOptions, rig: Rig) -> Any:
    """What reckons the run's own force error, if that was asked for. Raises InputError on a rig that is not simulated."""
    if not options.error_estimate:
        return None
    if rig.scene is None:
        raise InputError("only a simulated rig can repeat its run on another mesh", field="--error-estimate")
    from mjtactile.estimate import GraspEstimate

    return GraspEstimate(rig.scene)


def _watch(rig: Rig, recorder: RecorderLike) -> Any:
    """A score that looks at the truth after every physics step; None on a rig that has no truth."""
    if rig.scene is None:
        return None
    from mjtactile.scoring import GraspScore

    score = GraspScore(rig.scene)
    rig.scene.watch(score.after_step)
    recorder.note(break_force_N=rig.scene.object.break_force)
    return score


def _result(options: GraspOptions, log: _Log, score: Any, factor: float, *, completed: bool, period: float) -> GraspResult:
    """Put the loop's log and the score together. Without a truth, "held" is what the controller believes."""
    parts = {part: float(np.mean(ms)) for part, ms in log.milliseconds.items()}
    parts["rest"] = 1e3 * period / factor - sum(parts.values())
    parts["perception_median"] = float(np.median(log.milliseconds["perception"]))
    outcome = score.outcome() if score is not None else "held" if completed else "dropped"
    return GraspResult(
        options, outcome, log.peak_force(), score.peak_force if score else math.nan,
        log.hold_force(), score.hold_force if score else math.nan, score.slip if score else math.nan,
        factor, len(log.phases), parts)
