"""`Session`: a rig at work. References, control loop and supervision, the same for every job:
grasp, probe, record, calibrate, benchmarks. It sees a rig through its Protocols only, and never
ground truth.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

# numpy's median fetches it when it is first asked, where a run may have no descriptor left
import numpy.ma  # noqa: F401

from mjtactile.core import signals
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
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
from mjtactile.runtime.stepwise_control import StepwiseControl
from mjtactile.runtime.supervisor import Supervisor
from mjtactile.runtime.unsensed_force_monitor import UnsensedForceMonitor
from mjtactile.sensing.settings import DEFAULTS, Settings
from mjtactile.sensing.stateful_pipeline import StatefulPipeline

Say = Callable[[str], None]


class Session:
    """A rig and what its sensors know of themselves.

    Whoever builds the rig closes it: `open_session` does both.

    Args:
        rig: What is driven.
        perceptions: The sensing chain of each finger; None: made here, with `settings`.
        settings: Of the chains that are made here.
        threads: That perceive beside the loop (None: as many as are worth it here).
        pool: Processes that perceive instead of threads.
        shapes: Whether every touch has its shape, whatever the controller reads.
        say: Is given a line where something is worth saying.
    """

    def __init__(
        self,
        rig: Rig,
        perceptions: Sequence[Perceiver] | None = None,
        *,
        settings: Settings = DEFAULTS,
        threads: int | None = None,
        pool: PerceptionPool | None = None,
        shapes: bool = False,
        say: Say = lambda _: None,
    ):
        self.rig = rig
        self.settings = settings
        self._threads = threads
        self._pool = pool
        self._shapes = shapes
        self._say = say
        self._supervisor = Supervisor(rig.period)
        names = tuple(finger.name for finger in rig.fingers)
        self._push = UnsensedForceMonitor(names, rig.period)
        if perceptions is None and rig.touch_is_synthetic:
            perceptions = [SyntheticPerception() for _ in rig.fingers]
        elif perceptions is None:
            perceptions = [
                StatefulPipeline.of(finger.design, finger.calibration, settings=settings)
                for finger in rig.fingers
            ]
        self.perceptions: Sequence[Perceiver] = perceptions
        self._require_shapes(shapes)

    @property
    def disk_wait_time(self) -> float:
        """s that this world waits for a disk that is behind: a real one does not."""
        return 0.0 if math.isfinite(self.rig.host_timeout) else WAIT_TIME

    @property
    def flags(self) -> Mapping[str, str]:
        """What makes the numbers worse than usual, so far: the kind of doubt, and its reason. On a
        real rig there is one, "beyond": its servos push more than its fingers feel."""
        return {**self.rig.flags(), **self._push.flags}

    def take_references(self, observer: Observer | None = None) -> None:
        """Let every sensor measure itself: flat with the valve open to the air, then inflated,
        sealed, touching nothing.

        Args:
            observer: A recorder, for example: is given the images that it was done with.

        Raises:
            DeviceError: When what the cameras see does not agree with the sensor file.
        """
        observer = observer or Observer()
        rig = self.rig
        simulated = {"simulated": rig.simulated} if rig.simulated else {}
        observer.note(
            fingers=[finger.name for finger in rig.fingers],
            settings=self.settings.to_dict(),
            **simulated,
        )
        self._report_references(observer)
        if rig.touch_is_synthetic:  # nobody looks at references
            inflate(rig.fingers, rig.clock)
            return
        for reference in take_references(rig.fingers, rig.clock, self._say):
            observer.add_reference(reference.stage, reference.images, reference.gauge_pressure)
            self._zero(reference)

    def _zero(self, reference: ReferenceImages) -> None:
        """Have each chain take its own images as its reference."""
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
        """Name the parts of calibrations that do not count, and keep all of them with what is
        recorded."""
        known = {
            finger.name: finger.calibration
            for finger in self.rig.fingers
            if finger.calibration is not None
        }
        for finger in self.rig.fingers:
            states = known[finger.name].states(finger.design) if finger.name in known else []
            missing = ", ".join(part.kind for part in states if part.state == "missing")
            if missing:
                self._say(f"calibration of {finger.name}: never measured: {missing}")
            for part in states:
                if part.state in ("outdated", "refused"):
                    self._say(f"calibration of {finger.name}: {part.kind}: {part.text}")
        if known:
            observer.note(
                calibration={name: calibration.table() for name, calibration in known.items()}
            )

    def run(
        self,
        controller: LoadedController,
        *,
        time_limit: float,
        on_cycle: Callable[[Cycle], Any] | None = None,
        observer: Observer | None = None,
        supervisor: Supervisor | None = None,
    ) -> Command:
        """Run the controller until it says "done" or "abort"; see
        `mjtactile.runtime.control_loop.run_loop`.

        Args:
            controller: Is asked for a command in every cycle; where its file says `READS =
                ("shape",)`, every touch has its shape.
            time_limit: s on the rig's clock.
            on_cycle: Is given every cycle after its command was sent.
            observer: The same, and is also told when a cycle's images were taken.
            supervisor: Stands between controller and rig (None: a new one).

        Returns:
            The last command sent.

        Raises:
            InputError: The controller reads shapes, which are not drawn.
            ControllerError: What the controller did wrong.
            DeviceError: Also when a fault brought the rig to its safe state.
            Interrupted: When a signal asked the process to end.
            SimulationError: When the simulated world broke.
        """
        self._supervisor = Supervisor(self.rig.period) if supervisor is None else supervisor
        watching: list[Observer] = [] if observer is None else [observer]
        if on_cycle is not None:
            watching.append(CycleCallback(on_cycle))
        reads = "shape" in getattr(controller, "reads", ())
        self._require_shapes(self._shapes or reads, controller.path if reads else None)
        notes = FlagObserver(lambda: self.flags, Observers(watching))
        # a simulated world knows what its frames carry
        is_real = math.isfinite(self.rig.host_timeout)
        watched = [notes, self._push] if is_real else [notes]
        with signals.deferred() as stop, notes:
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
        """Give the rig out step by step, in place of `run`, to whoever has a loop of his own.

        Yields:
            The steps: `observe`, then `send`, again and again.
        """
        found = StepwiseControl(self.rig, self.perceptions, self._threads)
        try:
            yield found
        finally:
            found.close()

    def _require_shapes(self, asks: bool, source: Path | None = None) -> None:
        if asks and self.rig.touch_is_synthetic:
            who = "--shapes" if source is None else "a controller that reads shapes"
            raise InputError(f"{who} needs the chain", source=source, field="--effects -chain")
        for perception in self.perceptions:
            perception.shapes = asks

    def make_safe(self, reason: str) -> None:
        """From the next cycle of `run` on, lower and open the hand, whatever the controller says.

        For any thread.

        Args:
            reason: Why, for the summary.
        """
        self._supervisor.want_safe(reason)


@contextlib.contextmanager
def open_session(
    scenario: Scenario | str,
    design: SensorDesign | None = None,
    *,
    workers: int | None = None,
    settings: Settings = DEFAULTS,
    say: Say = lambda _: None,
    **fields: Any,
) -> Iterator[Session]:
    """Build the rig of a scenario, and bring it to its safe state on every way out, which no signal
    cuts short.

    Args:
        scenario: A scenario; or a rig's name alone, as `--rig` takes it.
        design: With a name: the sensor on the fingers.
        workers: What looks at the images beside the loop (None: as many as are worth it here, 0:
            nothing): threads on a real rig, processes beside a simulated world.
        settings: Of the sensing chains.
        say: Is given a line where something is worth saying.
        **fields: With a name: other fields of the scenario (`object_name` is its object).

    Yields:
        The session, its references not yet taken.

    Raises:
        InputError: For bad names or files.
        DeviceError: For a device that is not there.
        Interrupted: When a signal asked the process to end.
    """
    wanted = as_scenario(scenario, design, **fields)
    with signals.deferred():
        built = build_rig(wanted)
        with contextlib.ExitStack() as stack:
            stack.callback(built.close)
            pool = _start_pool(built, workers)
            if pool is not None:
                stack.callback(pool.close)
            yield Session(
                built, settings=settings, threads=workers, pool=pool, shapes=wanted.shapes, say=say
            )


def _start_pool(rig: Rig, workers: int | None) -> PerceptionPool | None:
    """Processes for a simulated rig's fingers; they start while the references are taken. None: no
    use, or no room, for them."""
    if rig.scene is None or rig.touch_is_synthetic:
        return None
    fingers = len(rig.fingers)
    count = default_count(fingers) if workers is None else min(workers, fingers)
    if count <= 0:
        return None
    with contextlib.suppress(OSError):
        return PerceptionPool(count)
    return None
