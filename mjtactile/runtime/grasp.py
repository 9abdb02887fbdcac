"""The main job: references, grasp, score. It joins the control loop, which has no ground truth, to
scoring, which uses it."""

from __future__ import annotations

import math
import time as wall
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mjtactile.core.errors import DeviceError, InputError, SimulationError
from mjtactile.core.fidelity_levels import disabled_effects
from mjtactile.core.fidelity_levels import fidelity_notes as fidelity_notes
from mjtactile.core.flags import Flags
from mjtactile.core.scenario import TIME_LIMIT, Scenario
from mjtactile.core.task import load_task
from mjtactile.core.types import Touch
from mjtactile.recording.observer import Observer, Observers
from mjtactile.rig.finger import Rig
from mjtactile.runtime.controller import LoadedController, load_controller
from mjtactile.runtime.cycle import Cycle
from mjtactile.runtime.device_faults import DeviceFaults
from mjtactile.runtime.failure_causes import actuator_limit, failure_causes
from mjtactile.runtime.held_contact import HeldContacts
from mjtactile.runtime.retreat import may_hold
from mjtactile.runtime.session import Session, open_session
from mjtactile.runtime.set_down import RELEASE_HEIGHT, SafeSetDown, SetDown


@dataclass(frozen=True)
class GraspResult:
    """Outcome of a grasp; forces on one finger, N, `slip`, m.

    `milliseconds` are mean wall times per control cycle of camera, perception, controller and the
    remainder. In simulation, the remainder is the wait for the world, which steps and renders
    meanwhile. `perception_median` is a median.
    """

    scenario: Scenario
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
    """Von Mises stress of a soft object, Pa. `peak_energy_true` is in J/m^3."""
    peak_energy_true: float = math.nan
    left_out: tuple[str, ...] = ()
    """Parts disabled by `--effects`: "mesh" (a quasi-static membrane replaced it), "pipeline"
    (synthetic touch) and "images" (markers with sampled errors)."""
    flags: Flags = field(default_factory=dict)
    """Reasons for reduced simulation accuracy, by kind of model error."""

    measures: Mapping[str, float] = field(default_factory=dict)
    """Ground-truth measures of the task, by name."""
    recorded: Mapping[str, Any] = field(default_factory=dict)
    """Names and outcome of the replayed run; empty: no replay."""
    has_truth: bool = True
    """False on a rig without ground truth: the outcome is then the controller's, or recorded."""
    success_criterion: str = ""
    """Criterion of the task."""
    contacts: tuple[Mapping[str, Any] | None, ...] = ()
    """Kind and area of the contact of each finger at the end of the hold; None: there was none."""
    device_fault: str = ""
    """Fault of a device during the run, for an object that was set down early; "": none."""

    def summary(self) -> dict[str, Any]:
        """Return the JSON object of `mjtactile grasp --json`. Unknown values are NaN, and null in
        JSON."""
        found = {
            "outcome": self.outcome,
            "peak_force_N": self.peak_force,
            "peak_force_true_N": self.peak_force_true,
            "hold_force_N": self.hold_force,
            "hold_force_true_N": self.hold_force_true,
            "slip_mm_true": 1e3 * self.slip_true,
            "real_time_factor": self.real_time_factor,
            "frames": self.frames,
            "perception_ms_median": self.milliseconds["perception_median"],
            "flags": self.flags,
            "success_criterion": self.success_criterion,
            **self.scenario.names(),
        }
        if not math.isnan(self.peak_stress_true):
            found["peak_stress_kPa_true"] = 1e-3 * self.peak_stress_true
            found["peak_energy_kJ_m3_true"] = 1e-3 * self.peak_energy_true
        if any(self.contacts):
            found["contacts"] = [
                None if contact is None else dict(contact) for contact in self.contacts
            ]
        found |= self.measures
        if self.reason:
            found["reason"] = self.reason
        if self.device_fault:
            found["device_fault"] = self.device_fault
        found |= dict.fromkeys(self.left_out, False)
        found["outcome_from"] = self.outcome_from
        if self.recorded:
            found["recorded"] = dict(self.recorded)
        if self.force_error_estimate is not None:
            found["force_error_estimate_N"] = self.force_error_estimate
        return found | {"scenario": self.scenario.to_dict()}

    @property
    def outcome_from(self) -> str:
        """Origin of the outcome: "ground truth", "recording" or "estimates"."""
        if self.recorded.get("outcome") in OUTCOMES:
            return "recording"
        return "ground truth" if self.has_truth else "estimates"


SET_DOWN = "not held: set down"
"""Outcome of a run that ended early while the object stood."""
OUTCOMES = ("held", "dropped", "crushed", "not set down", SET_DOWN, "fault")
"""Outcomes of a grasp; recordings of other jobs have others."""


_GRIPPING = ("close", "regulate", "lift", "hold")


class _Log(Observer):
    """Observer that collects the cycles for the result and forwards them with their ground
    truth."""

    def __init__(self, watching: Observer, score: Any, estimate: Any, place_height: float = 0.0):
        self._watching = watching
        self._set_down = SetDown(place_height)
        self._safe = SafeSetDown(place_height)
        self.devices = DeviceFaults()
        self.score = score
        self.estimate = estimate
        self.forces: list[tuple[float, ...]] = []
        self.contacts = HeldContacts()
        self.phases: list[str] = []
        self.stated_reason = ""
        self.left = ""
        self.grip_opening: float | None = None
        """Last measured opening in contact before the jaws opened, m; None: unknown."""
        parts = ("camera", "perception", "controller")
        self.milliseconds: dict[str, list[float]] = {part: [] for part in parts}

    def message(self, text: str) -> None:
        self._watching.message(text)

    def note(self, **facts: Any) -> None:
        self._watching.note(**facts)

    def on_images(self) -> None:
        if self.score is not None:
            self.score.snapshot(self._watching.sees)
        if self.estimate is not None and self.phases[-1:] == ["hold"]:
            self.estimate.keep()
        self._watching.on_images()

    def on_touches(self, time: float, touches: Sequence[Touch]) -> None:
        self._watching.on_touches(time, touches)

    def add(self, cycle: Cycle, view: Any = None, **truth: Any) -> None:
        self._set_down.watch(cycle.touch, cycle.sent)
        self._safe.watch(cycle.touch, cycle.sent)
        self.devices.watch(cycle)
        if cycle.sent.phase == "done" and self.phases[-1:] != ["done"]:
            self.left = "" if self._is_set_down(cycle) else _outcome_if_raised(cycle)
        self.contacts.add(cycle)
        self.forces.append(tuple(touch.force_normal for touch in cycle.touch))
        self.phases.append(cycle.sent.phase)
        self.stated_reason = cycle.sent.reason or self.stated_reason
        grips = cycle.sent.phase in _GRIPPING and any(touch.touching for touch in cycle.touch)
        if grips and math.isfinite(cycle.gripper.opening):
            self.grip_opening = cycle.gripper.opening
        for part, values in self.milliseconds.items():
            values.append(getattr(cycle, f"{part}_ms"))
        if self.score is None:
            self._watching.add(cycle)
        else:
            true = self.score.columns(cycle.touch, cycle.sent.phase)
            self._watching.add(cycle, self.score.view, **true)

    def _is_set_down(self, cycle: Cycle) -> bool:
        return self._set_down.stood and not any(map(may_hold, cycle.touch))

    @property
    def was_set_down(self) -> bool:
        """True if the object stood when the fingers opened, in a run that ended early."""
        return self._safe.stood or (self._set_down.stood and "release" in self.phases)

    def hold_force(self) -> float:
        pairs = zip(self.forces, self.phases, strict=True)
        held = [force for force, phase in pairs if phase == "hold"]
        return float(np.nanmean(held)) if np.isfinite(held).any() else math.nan

    def abort_reason(self, period: float) -> str:
        """Return time, phase and reason of the controller's abort, or ""."""
        before = [phase for phase in self.phases if phase != "abort"]
        if len(before) in (0, len(self.phases)):
            return ""
        return (
            f"the controller aborted in phase {before[-1]!r}, {len(before) * period:.1f} s "
            "after its start" + (f": {self.stated_reason}" if self.stated_reason else "")
        )

    def peak_force(self) -> float:
        return float(np.nanmax(self.forces)) if np.isfinite(self.forces).any() else math.nan


def run_grasp(
    scenario: Scenario,
    observers: Sequence[Observer] = (),
    *,
    controller: LoadedController | None = None,
    workers: int | None = None,
    error_estimate: bool = False,
) -> GraspResult:
    """Run one grasp, with `controller` in place of the scenario's if given.

    `workers` is the number of perception processes in simulation, or threads on a real rig (None:
    automatic). It does not change the result. With `error_estimate` the simulation is repeated on a
    coarser mesh to estimate the force error.

    Raises InputError for an invalid file or name, ControllerError, DeviceError (the rig is brought
    to its safe state on every exit path) and SimulationError.
    """
    watching = Observers(observers)
    controller = load_controller(scenario.controller) if controller is None else controller
    with open_session(scenario, workers=workers, notify=watching.message) as session:
        rig = session.rig
        watching.start(session)
        score = _score(scenario, rig, watching)
        # read before any motion: reading files may fail later
        criterion = load_task(scenario.task).success.text
        for note in _notes(scenario, rig):
            watching.message(note)
        session.take_references(watching)
        estimate = _estimate(rig) if error_estimate else None
        log = _Log(watching, score, estimate, rig.goal.place_height)
        completed, factor = _run(session, scenario, controller, log)
        flags = session.flags
        result = _result(scenario, log, factor, completed=completed, period=rig.period)
        try:
            result = replace(result, contacts=log.contacts.estimate(session.perceptions))
        except (OSError, ImportError) as error:  # no descriptors left; the run itself is over
            watching.message(f"contacts are not estimated: {error}")
        result = replace(result, flags=flags, recorded=rig.recorded, success_criterion=criterion)
        if result.outcome_from == "recording":
            reason = str(rig.recorded["error"] or "")
            result = replace(result, outcome=rig.recorded["outcome"], reason=reason)
        elif result.outcome in ("dropped", SET_DOWN):
            causes = failure_causes(rig, flags, log.grip_opening)
            result = replace(result, reason="; ".join(filter(None, [result.reason, *causes])))
    if log.estimate is None:
        return result
    return replace(result, force_error_estimate=log.estimate.force_error())


def _notes(scenario: Scenario, rig: Rig) -> list[str]:
    """Return notes on a simulated scene that limits the grasp: weak actuators, a rotated box."""
    scene = rig.scene
    if scene is None:
        return []
    width = scene.object.width
    weak = None if width is None else actuator_limit(rig, width)
    notes = [] if weak is None else [f"{scenario.rig}: {weak}"]
    oblique = scene.oblique_faces()
    return notes if oblique is None else [*notes, oblique]


def _time_limit(scenario: Scenario) -> float:
    """Return the time limit, s: the scenario's if set, else the task's."""
    if scenario.time_limit != TIME_LIMIT:
        return scenario.time_limit
    return load_task(scenario.task).time_limit


def _estimate(rig: Rig) -> Any:
    """Return the estimator of the run's force error. Raises InputError on a real rig."""
    if rig.scene is None:
        raise InputError(
            "only a simulated rig can repeat its run on another mesh", field="--error-estimate"
        )
    from mjtactile.runtime.discretization_error import GraspEstimate

    return GraspEstimate(rig.scene)


def _score(scenario: Scenario, rig: Rig, observer: Observer) -> Any:
    """Create the score, which samples the ground truth after every physics step.

    It is None on a rig without ground truth.
    """
    if rig.scene is None:
        return None
    from mjtactile.runtime.grasp_scoring import GraspScore
    from mjtactile.runtime.task_scoring import TaskScorer

    score = GraspScore(rig.scene, TaskScorer.of(scenario, rig))
    rig.scene.after_each_step_batch(score.after_step_batch, score.due)
    force = rig.scene.object.break_force
    randomized = {"randomized": rig.randomized} if rig.randomized else {}
    observer.note(break_force_N=force if math.isfinite(force) else None, **randomized)
    return score


def _run(
    session: Session, scenario: Scenario, controller: LoadedController, log: _Log
) -> tuple[bool, float]:
    """Run the controller; return True if it was completed, and the real-time factor."""
    rig = session.rig
    wall_start = wall.perf_counter()
    start = rig.clock.now()
    completed = False
    has_ended = False
    try:
        last = session.run(controller, time_limit=_time_limit(scenario), observer=log)
        completed = last.phase == "done"
    except SimulationError:
        if log.score is None or not log.score.lost:
            raise  # otherwise the object was not lifted, and the outcome is final
    except DeviceError:
        if rig.recorded.get("outcome") not in OUTCOMES:
            raise  # else the recording has ended before this controller did
        has_ended = True
    duration = rig.length if has_ended else rig.clock.now() - start
    return completed, duration / (wall.perf_counter() - wall_start)


def _outcome_if_raised(cycle: Cycle) -> str:
    """Return the outcome if the controller ended with the gripper raised, or ""."""
    if cycle.sent.lift_height <= RELEASE_HEIGHT:
        return ""
    return "not set down" if any(map(may_hold, cycle.touch)) else "dropped"


def _result(
    scenario: Scenario, log: _Log, factor: float, *, completed: bool, period: float
) -> GraspResult:
    """Combine the loop's log and the score.

    Without ground truth, "held" means that the controller reports a successful placement.
    """
    score = log.score
    parts = {part: float(np.mean(ms)) for part, ms in log.milliseconds.items()}
    parts["rest"] = 1e3 * period / factor - sum(parts.values())
    parts["perception_median"] = float(np.median(log.milliseconds["perception"]))
    if score is not None:
        outcome, reason = score.outcome(), score.reason()
        if outcome == "dropped" and not completed and score.is_standing:
            outcome = SET_DOWN
    else:
        early = SET_DOWN if log.was_set_down else "dropped"
        outcome = (log.left or "held") if completed else early
        reason = "the controller ended (done) with the gripper raised" if log.left else ""
    device_fault = log.devices.cause if outcome == SET_DOWN else ""
    return GraspResult(
        scenario,
        outcome,
        log.peak_force(),
        score.peak_force if score else math.nan,
        log.hold_force(),
        score.hold_force if score else math.nan,
        score.slip if score else math.nan,
        factor,
        len(log.phases),
        parts,
        reason="; ".join(filter(None, [reason, log.abort_reason(period), device_fault])),
        device_fault=device_fault,
        left_out=() if score is None else disabled_effects(score.world.effects),
        peak_stress_true=score.peak_stress if score else math.nan,
        peak_energy_true=score.peak_energy if score else math.nan,
        measures=score.measures() if score else {},
        has_truth=score is not None,
    )
