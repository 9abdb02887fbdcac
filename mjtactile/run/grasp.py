"""The main job: references, grasp, score. It joins the control loop, which knows no truth, to
scoring, which does."""

from __future__ import annotations

import math
import shlex
import time as wall
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError, SimulationError
from mjtactile.core.types import Image
from mjtactile.rig.finger import Rig
from mjtactile.rig.variation import NONE
from mjtactile.run.controller import Stepper, load_controller
from mjtactile.run.loop import Cycle
from mjtactile.run.session import Session, open_session

TIME_LIMIT = 60.0  # s on the rig's clock; a gentle grasp takes about 10


@dataclass(frozen=True)
class GraspOptions:
    """What to grasp, with what: shipped names or files, the rig, and the seed of placement and
    noise, and of what is drawn from the ranges of `vary`. `workers` processes beside a simulated
    world, or threads on a real rig, look at the images (None: as many as are worth it here); the
    result is the same with any number of them."""

    object: str = "egg"
    sensor: str = "dense"
    controller: str = "gentle"
    rig: str = "sim"
    seed: int = 0
    accuracy: str = ""
    effects: str = "auto"
    vary: str = NONE
    error_estimate: bool = False
    workers: int | None = None

    def command(self) -> str:
        """How to run it again from a shell; the number of workers changes nothing."""
        words = [
            "mjtactile",
            "grasp",
            "--object",
            self.object,
            "--controller",
            self.controller,
            "--seed",
            str(self.seed),
        ]
        for name, default in (
            ("sensor", "dense"),
            ("rig", "sim"),
            ("accuracy", ""),
            ("effects", "auto"),
            ("vary", NONE),
        ):
            if getattr(self, name) != default:
                words += [f"--{name}={getattr(self, name)}"]
        return shlex.join(words)


class RecorderLike(Protocol):
    patience: float

    def note(self, **values: Any) -> None: ...
    def add_reference(
        self, stage: str, images: list[list[Image]], pressure_gauge: list[float | None]
    ) -> None: ...
    def add(self, cycle: Cycle, **truth: Any) -> None: ...


class ProgressLike(Protocol):
    def message(self, text: str) -> None: ...
    def update(self, phase: str, time: float, force: float) -> None: ...


@dataclass(frozen=True)
class GraspResult:
    """Outcome of a grasp; forces in N on one finger, `slip` m. `milliseconds` are means of wall
    time per control cycle for camera, perception, controller and the rest (in simulation: waiting
    for the world, which steps and draws meanwhile); `perception_median` is a median."""

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
    reason: str = ""
    peak_stress_true: float = math.nan
    """Pa, von Mises, of a soft object; `peak_energy_true` J/m^3."""
    peak_energy_true: float = math.nan
    images: bool = True
    """False: no image was drawn (`--effects -images`); markers had errors drawn in place of those
    of the image stages."""

    def summary(self) -> dict[str, Any]:
        """The JSON object of `mjtactile grasp --json`; what is unknown is NaN here and null
        there."""
        names = {
            key: Path(getattr(self.options, key)).stem for key in ("object", "sensor", "controller")
        }
        return {
            "outcome": self.outcome,
            "peak_force_N": self.peak_force,
            "peak_force_true_N": self.peak_force_true,
            "hold_force_N": self.hold_force,
            "hold_force_true_N": self.hold_force_true,
            "slip_mm_true": 1e3 * self.slip_true,
            "real_time_factor": self.real_time_factor,
            "frames": self.frames,
            "perception_ms_median": self.milliseconds["perception_median"],
            **names,
            "seed": self.options.seed,
            **(
                {}
                if math.isnan(self.peak_stress_true)
                else {
                    "peak_stress_kPa_true": 1e-3 * self.peak_stress_true,
                    "peak_energy_kJ_m3_true": 1e-3 * self.peak_energy_true,
                }
            ),
            **({"reason": self.reason} if self.reason else {}),
            **({} if self.images else {"images": False}),
            **(
                {}
                if self.force_error_estimate is None
                else {"force_error_estimate_N": self.force_error_estimate}
            ),
        }


@dataclass
class _Log:
    """What the loop says, cycle by cycle, for the result."""

    forces: list[tuple[float, ...]] = field(default_factory=list)
    phases: list[str] = field(default_factory=list)
    milliseconds: dict[str, list[float]] = field(
        default_factory=lambda: {"camera": [], "perception": [], "controller": []}
    )

    def add(self, cycle: Cycle) -> None:
        self.forces.append(tuple(touch.force_normal for touch in cycle.touch))
        self.phases.append(cycle.sent.phase)
        for part, values in self.milliseconds.items():
            values.append(getattr(cycle, f"{part}_ms"))

    def hold_force(self) -> float:
        held = [
            force for force, phase in zip(self.forces, self.phases, strict=True) if phase == "hold"
        ]
        return float(np.nanmean(held)) if np.isfinite(held).any() else math.nan

    def gave_up(self, period: float) -> str:
        """When and at what the controller gave up, "" if it did not."""
        before = [phase for phase in self.phases if phase != "abort"]
        if len(before) in (0, len(self.phases)):
            return ""
        return (
            f"the controller gave up in phase {before[-1]!r}, {len(before) * period:.1f} s "
            "after it began"
        )

    def peak_force(self) -> float:
        return float(np.nanmax(self.forces)) if np.isfinite(self.forces).any() else math.nan


def run_grasp(
    options: GraspOptions,
    *,
    recorder: RecorderLike,
    progress: ProgressLike,
    on_open: Callable[[Session], None] = lambda _: None,
    on_still: Callable[[], None] = lambda: None,
    wrap: Callable[[Stepper], Stepper] = lambda it: it,
    time_limit: float = TIME_LIMIT,
) -> GraspResult:
    """Run one grasp on the rig that `options` names, within `time_limit` s; `on_open` is given the
    session before anything moves, `wrap` the controller, and `on_still` is called in every cycle
    when its images were taken and a simulated world stands still.

    Raises InputError for bad files or names, ControllerError, DeviceError, SimulationError; the rig
    is brought to its safe state on every way out.
    """
    design = load_sensor(options.sensor)
    controller = wrap(load_controller(options.controller))
    with open_session(
        options.rig,
        design,
        object_name=options.object,
        seed=options.seed,
        accuracy=options.accuracy,
        effects=options.effects,
        vary=options.vary,
        workers=options.workers,
        say=progress.message,
    ) as session:
        rig = session.rig
        on_open(session)
        recorder.patience = session.patience
        score = _score(rig, recorder)
        session.take_references(recorder)
        log = _Log()
        estimate = _estimate(options, rig)

        def on_images() -> None:
            if score is not None:
                score.snapshot()
            if estimate is not None and log.phases and log.phases[-1] == "hold":
                estimate.keep()
            on_still()

        def on_cycle(cycle: Cycle) -> None:
            log.add(cycle)
            recorder.add(
                cycle,
                **(
                    {}
                    if score is None
                    else score.columns(cycle.touch, cycle.sent.phase) | {"view": score.view}
                ),
            )
            progress.update(cycle.sent.phase, cycle.time, float(np.mean(log.forces[-1])))

        begin = wall.perf_counter()
        start = rig.clock.now()
        completed = False
        try:
            last = session.run(
                controller, time_limit=time_limit, on_cycle=on_cycle, on_images=on_images
            )
            completed = last.phase == "done"
        except SimulationError:
            if score is None or not score.lost:
                raise  # else the grasp was decided before: the object had stayed behind
        factor = (rig.clock.now() - start) / (wall.perf_counter() - begin)
    result = _result(options, log, score, factor, completed=completed, period=rig.period)
    return (
        result if estimate is None else replace(result, force_error_estimate=estimate.force_error())
    )


def _estimate(options: GraspOptions, rig: Rig) -> Any:
    """What reckons the run's own force error, if that was asked for. Raises InputError on a rig
    that is not simulated."""
    if not options.error_estimate:
        return None
    if rig.scene is None:
        raise InputError(
            "only a simulated rig can repeat its run on another mesh", field="--error-estimate"
        )
    from mjtactile.run.estimate import GraspEstimate

    return GraspEstimate(rig.scene)


def _score(rig: Rig, recorder: RecorderLike) -> Any:
    """A score that looks at the truth after every physics step; None on a rig that has no truth."""
    if rig.scene is None:
        return None
    from mjtactile.run.scoring import GraspScore

    score = GraspScore(rig.scene)
    rig.scene.after_each_step(score.after_step)
    force = rig.scene.object.break_force
    recorder.note(
        break_force_N=force if math.isfinite(force) else None,
        **({"varied": rig.varied} if rig.varied else {}),
    )
    return score


def _result(
    options: GraspOptions, log: _Log, score: Any, factor: float, *, completed: bool, period: float
) -> GraspResult:
    """Put the loop's log and the score together. Without a truth, "held" is what the controller
    believes."""
    parts = {part: float(np.mean(ms)) for part, ms in log.milliseconds.items()}
    parts["rest"] = 1e3 * period / factor - sum(parts.values())
    parts["perception_median"] = float(np.median(log.milliseconds["perception"]))
    outcome = score.outcome() if score is not None else "held" if completed else "dropped"
    return GraspResult(
        options,
        outcome,
        log.peak_force(),
        score.peak_force if score else math.nan,
        log.hold_force(),
        score.hold_force if score else math.nan,
        score.slip if score else math.nan,
        factor,
        len(log.phases),
        parts,
        reason=(score.reason() if score else "") or log.gave_up(period),
        images=score is None or "images" in score.world.effects,
        peak_stress_true=score.peak_stress if score else math.nan,
        peak_energy_true=score.peak_energy if score else math.nan,
    )
