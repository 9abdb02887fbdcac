"""Probe of an object: press, hold, release, touch again, and classify its material.

It runs on a rig or on a recording. Like `mjtactile.runtime.grasp` it combines the control loop and
a result. It does not use ground truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mjtactile.core.errors import InputError
from mjtactile.core.flags import Flags
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Material, Touch
from mjtactile.recording.observer import Observer, Observers
from mjtactile.recording.reader import Recording
from mjtactile.recording.recorded_sensors import recorded_sensors
from mjtactile.runtime.controller import load_controller
from mjtactile.runtime.cycle import Cycle
from mjtactile.runtime.re_estimation import replay_session, replay_touches
from mjtactile.runtime.session import open_session
from mjtactile.sensing.settings import DEFAULTS, Settings
from mjtactile.sensing.touch.material import estimate_material
from mjtactile.sensing.touch.squeeze import Squeeze


class _Log(Observer):
    """Observer that stores the touch of every cycle."""

    def __init__(self) -> None:
        self.touches: list[tuple[Touch, ...]] = []
        self.openings: list[float] = []
        self.phases: list[str] = []

    def add(self, cycle: Cycle, view: Any = None, **truth: Any) -> None:
        self.keep(cycle.touch, cycle.gripper.opening, cycle.sent.phase)

    def keep(self, touch: Sequence[Touch], opening: float, phase: str) -> None:
        self.touches.append(tuple(touch))
        self.openings.append(opening)
        self.phases.append(phase)

    def result(self, names: dict[str, Any], settings: Settings, flags: Flags) -> ProbeResult:
        squeeze = Squeeze.of(self.touches, self.openings, settings.squeeze)
        material = estimate_material(squeeze, settings.material)
        return ProbeResult(names, material, squeeze, tuple(self.phases), flags)


@dataclass(frozen=True, eq=False)
class ProbeResult:
    """Result of a probe with its time series. `frames` is the number of control cycles."""

    names: dict[str, Any]
    material: Material
    squeeze: Squeeze
    phases: tuple[str, ...]
    flags: Flags = field(default_factory=dict)
    """Reasons for reduced simulation accuracy, by kind of model error."""

    def summary(self) -> dict[str, Any]:
        """Return the JSON object of `mjtactile probe --json`. Unknown values are NaN, null in
        JSON."""
        m = self.material
        return {
            **self.names,
            "material": m.kind,
            "probability": dict(m.probability),
            "status": m.status,
            "force_N": m.force,
            "deformation_mm": 1e3 * m.deformation,
            "stiffness_N_m": m.stiffness,
            "stiffness_interval_N_m": m.stiffness_interval,
            "modulus_kPa": 1e-3 * m.modulus,
            "modulus_interval_kPa": [1e-3 * value for value in m.modulus_interval],
            "relaxation_time_s": m.relaxation_time,
            "permanent_set_mm": 1e3 * m.permanent_set,
            "permanent_set_sd_mm": 1e3 * m.permanent_set_sd,
            "deformation_speed_mm_s": 1e3 * m.speed,
            "frames": len(self.squeeze),
            "flags": self.flags,
        }

    def history(self) -> dict[str, Any]:
        """Return the samples used for the classification, as lists with one value per cycle."""
        s = self.squeeze
        return {
            "time_s": s.time,
            "phase": list(self.phases),
            "opening_mm": 1e3 * s.opening,
            "force_N": s.force,
            "force_sd_N": s.force_sd,
            "width_mm": 1e3 * s.width,
            "width_sd_mm": 1e3 * s.width_sd,
            "area_mm2": 1e6 * s.area,
        }


def run_probe(
    scenario: Scenario, observers: Sequence[Observer] = (), *, settings: Settings = DEFAULTS
) -> ProbeResult:
    """Squeeze an object and classify its material.

    `settings` are those of the sensing pipelines and of the classification. Raises InputError for
    an invalid file or name, ControllerError, DeviceError (the rig is closed on every exit path) and
    SimulationError.
    """
    watching = Observers(observers)
    controller = load_controller(scenario.controller)
    log = _Log()
    # materials were calibrated with the nodal area
    with open_session(
        scenario, settings=settings, contact_shapes=False, notify=watching.message
    ) as session:
        watching.start(session)
        session.take_references(watching)
        session.run(controller, time_limit=scenario.time_limit, observer=Observers([log, watching]))
        flags = session.flags
    names = scenario.names()
    del names["controller"]
    if session.rig.recorded:
        names["recorded"] = dict(session.rig.recorded)
    return log.result(names, settings, flags)


def replay_probe(
    recording: Recording, sensor: str | None = None, *, settings: Settings = DEFAULTS
) -> ProbeResult:
    """Classify the material again from the images of a recording of a probe or any squeeze.

    It is evaluated with its own sensors. Raises InputError if the recording has no references,
    images are missing, or it was recorded with another `sensor` than the given one.
    """
    recording.require_images()
    stages = {reference.stage for reference in recording.references}
    if not {"flat", "rest"} <= stages or not recording.width:
        message = "has no reference images (flat and rest): the sensors cannot be zeroed"
        raise InputError(message, source=recording.folder)
    sensors = recorded_sensors(recording, sensor)
    session = replay_session(
        recording, settings=settings, contact_shapes=recording.has_shape_forces
    )
    log = _Log()
    for cycle, touch in enumerate(replay_touches(recording, session)):
        log.keep(
            touch,
            float(recording.columns["opening"][cycle]),
            str(recording.columns["phase"][cycle]),
        )
    header = recording.header
    return log.result(
        {
            "object": Path(str(header.get("object", "unknown"))).stem,
            "sensor": ", ".join(dict.fromkeys(one.name for one in sensors.values())),
            "seed": header.get("seed"),
            "recorded": recording.facts(),
        },
        settings,
        session.flags,
    )
