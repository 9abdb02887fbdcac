"""The second job: press, hold, release, touch again, and say what the object is made of. Live on a
rig, or replayed.

Like `mjtactile.run.grasp` it joins the control loop to a result; no truth takes part in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.types import Image, Material, Touch
from mjtactile.recording.reader import Recording
from mjtactile.run.controller import load_controller
from mjtactile.run.loop import Cycle
from mjtactile.run.session import open_session
from mjtactile.sensing.chain import Perception
from mjtactile.sensing.settings import DEFAULTS, Settings
from mjtactile.sensing.touch.material import judge
from mjtactile.sensing.touch.squeeze import Squeeze

TIME_LIMIT = 60.0  # s on the rig's clock; a probe takes about 12


@dataclass(frozen=True)
class ProbeOptions:
    """What to probe, with what; as for a grasp."""

    object: str = "sponge"
    sensor: str = "dense"
    controller: str = "probe"
    rig: str = "sim"
    seed: int = 0


class RecorderLike(Protocol):
    patience: float

    def note(self, **values: Any) -> None: ...
    def add_reference(
        self, stage: str, images: list[list[Image]], pressure_gauge: list[float | None]
    ) -> None: ...
    def add(self, cycle: Cycle, **truth: Any) -> None: ...


@dataclass
class _Log:
    """What the sensors said, cycle by cycle."""

    touches: list[tuple[Touch, ...]] = field(default_factory=list)
    openings: list[float] = field(default_factory=list)
    phases: list[str] = field(default_factory=list)

    def add(self, touch: Sequence[Touch], opening: float, phase: str) -> None:
        self.touches.append(tuple(touch))
        self.openings.append(opening)
        self.phases.append(phase)

    def result(self, names: dict[str, Any], settings: Settings) -> ProbeResult:
        squeeze = Squeeze.of(self.touches, self.openings, settings.squeeze)
        return ProbeResult(names, judge(squeeze, settings.material), squeeze, tuple(self.phases))


@dataclass(frozen=True, eq=False)
class ProbeResult:
    """What was found, and the history that it was found in. `frames` is the number of control
    cycles."""

    names: dict[str, Any]
    material: Material
    squeeze: Squeeze
    phases: tuple[str, ...]

    def summary(self) -> dict[str, Any]:
        """The JSON object of `mjtactile probe --json`; unknown is NaN here and null there."""
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
        }

    def history(self) -> dict[str, Any]:
        """The samples behind the verdict, lists of one value a cycle."""
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
    options: ProbeOptions,
    *,
    recorder: RecorderLike | None = None,
    say: Callable[[str], None] = lambda _: None,
    settings: Settings = DEFAULTS,
) -> ProbeResult:
    """Probe on the rig that `options` names.

    Raises InputError, ControllerError, DeviceError, SimulationError; the rig is closed on every way
    out.
    """
    design = load_sensor(options.sensor)
    controller = load_controller(options.controller)
    log = _Log()

    def on_cycle(cycle: Cycle) -> None:
        if log.phases[-1:] != [cycle.sent.phase]:
            say(f"{cycle.time:6.2f} s  {cycle.sent.phase}")
        log.add(cycle.touch, cycle.gripper.opening, cycle.sent.phase)
        if recorder is not None:
            recorder.add(cycle)

    with open_session(
        options.rig,
        design,
        object_name=options.object,
        seed=options.seed,
        settings=settings,
        say=say,
    ) as session:
        if recorder is not None:
            recorder.patience = session.patience
        session.take_references(recorder)
        session.run(controller, time_limit=TIME_LIMIT, on_cycle=on_cycle)
    return log.result(
        {
            "object": Path(options.object).stem,
            "sensor": Path(options.sensor).stem,
            "seed": options.seed,
        },
        settings,
    )


def replay_probe(
    recording: Recording, sensor: str | None = None, *, settings: Settings = DEFAULTS
) -> ProbeResult:
    """The verdict on a recording (of a probe, or of any squeeze), from its images again.

    Raises InputError when the recording has no references or images are missing.
    """
    recording.require_images()
    name = sensor or str(recording.header.get("sensor", "dense"))
    design = load_sensor(name)
    stages = {reference.stage: reference for reference in recording.references}
    if not {"flat", "rest"} <= set(stages) or not recording.width:
        raise InputError(
            "has no reference images (flat and rest): the sensors cannot be zeroed",
            source=recording.folder,
        )
    perceptions = [Perception.of(design, settings=settings) for _ in range(recording.width)]
    for finger, perception in enumerate(perceptions):
        perception.take_flat(list(stages["flat"].images(finger)))
        gauge = stages["rest"].pressure_gauge[finger]
        perception.take_rest(
            list(stages["rest"].images(finger)),
            design.chamber.supply_gauge if gauge is None else gauge,
        )
    log = _Log()
    for cycle, images in enumerate(recording.images()):
        now = float(recording.columns["time"][cycle])
        touch = [
            perception.perceive(image, now)
            for perception, image in zip(perceptions, images, strict=True)
        ]
        log.add(
            touch,
            float(recording.columns["opening"][cycle]),
            str(recording.columns["phase"][cycle]),
        )
    header = recording.header
    return log.result(
        {
            "object": Path(str(header.get("object", "unknown"))).stem,
            "sensor": Path(name).stem,
            "seed": header.get("seed"),
        },
        settings,
    )
