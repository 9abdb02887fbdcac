"""`Session`: a rig in use. References, control loop and supervision, the same for every job: grasp,
probe, record, calibrate, benchmarks. It accesses a rig only through its Protocols, without ground
truth.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

# numpy's median fetches it at its first use, when a run may have no descriptor left
import numpy.ma  # noqa: F401

from mjtactile.core import signals
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.flags import Flags, merge_flags
from mjtactile.core.option_requirements import require_effects
from mjtactile.core.scenario import Scenario
from mjtactile.core.signature_checks import above, not_below, shown, validated
from mjtactile.core.types import Command
from mjtactile.recording.observer import CycleCallback, Observer, Observers
from mjtactile.rig.finger import Rig
from mjtactile.rig.registry import as_scenario, build_rig
from mjtactile.runtime.control_loop import run_loop
from mjtactile.runtime.controller import LoadedController
from mjtactile.runtime.cycle import WAIT_TIME, Cycle
from mjtactile.runtime.flag_observer import FlagObserver
from mjtactile.runtime.perception_processes import PerceptionPool, default_count
from mjtactile.runtime.perception_threads import Perceiver, SyntheticPerception
from mjtactile.runtime.references import ReferenceImages, inflate, take_references
from mjtactile.runtime.slowness_monitor import SlownessMonitor
from mjtactile.runtime.stepwise_control import StepwiseControl
from mjtactile.runtime.supervisor import Supervisor
from mjtactile.runtime.uncertain_force_monitor import UncertainForceMonitor
from mjtactile.runtime.unsensed_force_monitor import UnsensedForceMonitor
from mjtactile.sensing.contact_shape.start_files import ensure_start
from mjtactile.sensing.settings import DEFAULTS, Settings
from mjtactile.sensing.stateful_pipeline import StatefulPipeline

Notify = Callable[[str], None]


@validated(threads=not_below(0))
class Session:
    """Rig with its sensing pipelines and their references.

    The caller that builds the rig must close it: `open_session` does both.

    Args:
        rig: The rig.
        perceptions: Sensing pipeline of each finger; None: created here with `settings`.
        settings: Settings of the pipelines created here; None: the defaults.
        threads: Number of perception threads in addition to the loop (None: automatic).
        pool: Perception processes instead of threads.
        contact_shapes: As for `StatefulPipeline`; True also if the controller requires it.
        notify: Callback for messages, one line each.
    """

    def __init__(
        self,
        rig: Rig,
        perceptions: Sequence[Perceiver] | None = None,
        *,
        settings: Settings | None = None,
        threads: int | None = None,
        pool: PerceptionPool | None = None,
        contact_shapes: bool | None = None,
        notify: Notify = lambda _: None,
    ):
        self.rig = rig
        self.settings = DEFAULTS if settings is None else settings
        self._threads = threads
        self._pool = pool
        self._shapes = contact_shapes
        self._notify = notify
        self.is_closed = False
        """True once its rig was closed."""
        self._has_references = False
        self._user = ""
        self._supervisor = Supervisor(rig.period)
        names = tuple(finger.name for finger in rig.fingers)
        self._push = UnsensedForceMonitor(names, rig.period)
        self.monitor = UncertainForceMonitor(names)
        if perceptions is None and rig.touch_is_synthetic:
            perceptions = [SyntheticPerception() for _ in rig.fingers]
        elif perceptions is None:
            perceptions = [
                StatefulPipeline.of(
                    finger.design,
                    finger.calibration,
                    settings=_for_simulation(self.settings, finger.design, rig.simulated),
                )
                for finger in rig.fingers
            ]
        self.perceptions: Sequence[Perceiver] = perceptions
        self._require_shapes(bool(contact_shapes))

    @property
    def disk_wait_time(self) -> float:
        """Maximum wait of this world for a slow disk, s; 0 on a real rig."""
        return 0.0 if math.isfinite(self.rig.host_timeout) else WAIT_TIME

    @property
    def flags(self) -> Flags:
        """Reasons for reduced accuracy so far, by kind of model error.

        On a real rig the kinds are "uncertain", and "unsensed_force": the servo forces exceed the
        forces estimated on the fingers.
        """
        return merge_flags((self.rig.flags(), self._push.flags, self.monitor.flags))

    def take_references(self, observer: Observer | None = None) -> None:
        """Take the references of every sensor.

        They are taken flat with the valve open to the air, then inflated and sealed, without
        contact.

        Args:
            observer: Observer that receives the reference images, for example a recorder.

        Raises:
            DeviceError: The camera images do not agree with the sensor file.
        """
        self._require_free()
        observer = observer or Observer()
        self._has_references = False
        rig = self.rig
        simulated = {"simulated": rig.simulated} if rig.simulated else {}
        observer.note(
            fingers=[finger.name for finger in rig.fingers],
            settings=self.settings.to_dict(),
            contact_shapes=bool(self._shapes),
            **simulated,
        )
        sensors = {finger.name: finger.design.stored_file() for finger in rig.fingers}
        observer.note(sensors=sensors)
        self._report_references(observer)
        if rig.touch_is_synthetic:  # references are not used
            inflate(rig.fingers, rig.clock)
            self._has_references = True
            return
        for reference in take_references(rig.fingers, rig.clock, self._notify):
            observer.add_reference(reference.stage, reference.images, reference.gauge_pressure)
            self._zero(reference)
        self._has_references = True

    def _zero(self, reference: ReferenceImages) -> None:
        """Measure the reference of each sensing pipeline from its own images."""
        pressures = iter(reference.gauge_pressure)
        for finger, perception, images in zip(
            self.rig.fingers, self.perceptions, reference.images, strict=True
        ):
            gauge = next(pressures) if finger.valve is not None else None
            if reference.stage == "flat":
                perception.measure_flat_reference(images)
            else:
                perception.measure_rest_reference(images, finger.pressure(gauge))

    def _report_references(self, observer: Observer) -> None:
        """Report the unused parts of the calibrations, and record all calibrations."""
        known = {
            finger.name: finger.calibration
            for finger in self.rig.fingers
            if finger.calibration is not None
        }
        for finger in self.rig.fingers:
            states = known[finger.name].states(finger.design) if finger.name in known else []
            missing = ", ".join(part.kind for part in states if part.state == "missing")
            if missing:
                self._notify(f"calibration of {finger.name}: never measured: {missing}")
            for part in states:
                if part.state in ("outdated", "refused"):
                    self._notify(f"calibration of {finger.name}: {part.kind}: {part.text}")
        if known:
            observer.note(
                calibration={name: calibration.table() for name, calibration in known.items()}
            )

    @validated(time_limit=above(0, math.inf))
    def run(
        self,
        controller: LoadedController,
        *,
        time_limit: float,
        on_cycle: Callable[[Cycle], Any] | None = None,
        observer: Observer | None = None,
        supervisor: Supervisor | None = None,
    ) -> Command:
        """Run the controller until it returns the phase "done" or "abort".

        See `mjtactile.runtime.control_loop.run_loop`.

        Args:
            controller: Controller that returns a command in every cycle. If its file contains
                `REQUIRES = ("contact_shape",)`, force and slip come from the contact shape.
            time_limit: Time limit on the rig's clock, s.
            on_cycle: Function called with every cycle after its command was sent.
            observer: Observer of every cycle, also called after the images of a cycle were taken.
            supervisor: Supervisor between controller and rig (None: a new one).

        Returns:
            The last command sent.

        Raises:
            InputError: The controller requires shapes, but the touch is synthetic. It is not a
                controller, or the session is closed, in use or without references.
            ControllerError: The controller failed.
            DeviceError: A device failed; also after a fault brought the rig to its safe state.
            Interrupted: A signal requested the end of the process.
            SimulationError: The simulation failed.
        """
        self._require_free()
        if not (callable(getattr(controller, "step", None)) and hasattr(controller, "path")):
            choices = ["mjtactile.load_controller(FILE)"]
            text = f"{shown(controller)} is not a controller"
            raise InputError(text, source="Session.run", field="controller", choices=choices)
        self._supervisor = Supervisor(self.rig.period) if supervisor is None else supervisor
        watching: list[Observer] = [] if observer is None else [observer]
        if on_cycle is not None:
            watching.append(CycleCallback(on_cycle))
        reads = "contact_shape" in getattr(controller, "reads", ())
        uses = bool(self._shapes) or reads
        self._require_shapes(uses, controller.path if reads else None)
        Observers(watching).note(contact_shapes=uses)
        notes = FlagObserver(lambda: self.flags, Observers(watching))
        # simulation provides the forces outside the sensors, so only a real rig is monitored
        is_real = math.isfinite(self.rig.host_timeout)
        watched: list[Observer] = [notes, self.monitor, *([self._push] if is_real else [])]
        if self.rig.workload is not None:
            notify = Observers(watching).message
            watched.append(SlownessMonitor(self.rig.workload, notify, contact_shapes=uses))
        with signals.deferred() as stop, notes, self._in_use("run"):
            return run_loop(
                self.rig,
                self.perceptions,
                controller,
                time_limit=time_limit,
                observer=Observers([*watched, *watching]),
                supervisor=self._supervisor,
                stop=stop,
                threads=self._threads,
                pool=self._pool,
            )

    @contextlib.contextmanager
    def steps(self) -> Iterator[StepwiseControl]:
        """Provide stepwise control of the rig for a caller with its own loop, in place of `run`.

        Yields:
            The stepwise control: call `observe`, then `send`, repeatedly.

        Raises:
            InputError: The session is closed, in use or without references.
        """
        self._require_free()
        with self._in_use("steps"):
            found = StepwiseControl(self.rig, self.perceptions, self._threads, self.monitor)
            try:
                yield found
            finally:
                found.close()

    @contextlib.contextmanager
    def _in_use(self, user: str) -> Iterator[None]:
        """Reserve the rig for one loop. Raises InputError without references."""
        if not self._has_references:
            text = f"has no references: call take_references() before {user}"
            raise InputError(text, source="Session")
        self._user = user
        try:
            yield
        finally:
            self._user = ""

    def _require_free(self) -> None:
        if self.is_closed:
            raise InputError("is closed: open another one", source="Session")
        if self._user:
            raise InputError(f"is in use by {self._user}: end it first", source="Session")

    def _require_shapes(self, asks: bool, source: Path | None = None) -> None:
        if asks and self.rig.touch_is_synthetic:
            requested: Any = {"contact_shapes": True}
            if source is not None:
                requested = {"REQUIRES": "contact_shape"}
            require_effects((), source, **requested)
        for perception in self.perceptions:
            perception.contact_shapes = True if asks else self._shapes
        if asks:
            for finger in self.rig.fingers:
                ensure_start(finger.design, self.settings.contact_shape, self._notify)

    @validated()
    def make_safe(self, reason: str) -> None:
        """Lower and open the gripper from the next cycle of `run` on.

        The controller's commands are ignored. The method can be called from any thread.

        Args:
            reason: Reason, for the summary.
        """
        self._supervisor.request_safe_state(reason)


@contextlib.contextmanager
@validated(workers=not_below(0))
def open_session(
    scenario: Scenario | str,
    design: SensorDesign | None = None,
    *,
    workers: int | None = None,
    settings: Settings | None = None,
    contact_shapes: bool | None = None,
    notify: Notify = lambda _: None,
    **fields: Any,
) -> Iterator[Session]:
    """Open a session with the rig of a scenario, in simulation or on devices.

    The session takes references, estimates touch and runs controllers. The rig is brought to its
    safe state on every exit path. Signals do not interrupt the shutdown.

    Args:
        scenario: A scenario; or a rig's name alone, as for `--rig`.
        design: Sensor on the fingers; only with a name.
        workers: Number of perception workers in addition to the loop (None: automatic, 0: none):
            threads on a real rig, processes in simulation.
        settings: Settings of the sensing pipelines; None: the defaults.
        contact_shapes: As for `StatefulPipeline`, unless the scenario requests them.
        notify: Callback for messages, one line each.
        **fields: Other fields of the scenario; only with a name (`object_name` is its object).

    Yields:
        The session, before its references are taken.

    Raises:
        InputError: A name or file is invalid.
        DeviceError: A device is missing.
        Interrupted: A signal requested the end of the process.
    """
    requested = as_scenario(scenario, design, **fields)
    with signals.deferred():
        built = build_rig(requested)
        with contextlib.ExitStack() as stack:
            stack.callback(built.close)
            pool = _start_pool(built, workers)
            if pool is not None:
                stack.callback(pool.close)
            session = Session(
                built,
                settings=settings,
                threads=workers,
                pool=pool,
                contact_shapes=requested.contact_shapes or contact_shapes,
                notify=notify,
            )
            try:
                yield session
            finally:
                session.is_closed = True


def _for_simulation(
    settings: Settings, design: SensorDesign, simulated: Mapping[str, Any]
) -> Settings:
    """Return the settings of a finger's pipeline. A simulated mesh has larger model errors."""
    effects = simulated.get("effects", ())
    if not any(effect.get("effect") == "mesh" and effect.get("on") for effect in effects):
        return settings
    columns, rows = simulated["mesh"]
    return settings.for_mesh(design, (columns, rows))


def _start_pool(rig: Rig, workers: int | None) -> PerceptionPool | None:
    """Start processes for a simulated rig's fingers. Their start overlaps the references. None:
    they bring no gain or cannot start."""
    if rig.scene is None or rig.touch_is_synthetic:
        return None
    fingers = len(rig.fingers)
    count = default_count(fingers) if workers is None else min(workers, fingers)
    if count <= 0:
        return None
    with contextlib.suppress(OSError):
        return PerceptionPool(count)
    return None
