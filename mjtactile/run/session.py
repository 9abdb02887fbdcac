"""`Session`: a rig at work. References, control loop and supervision, the same for every job:
grasp, probe, record, calibrate, benchmarks. It sees a rig through its Protocols only, and never
ground truth.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

from mjtactile.core import signals
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Command, Image
from mjtactile.rig.finger import Rig
from mjtactile.rig.registry import build_rig
from mjtactile.rig.variation import NONE
from mjtactile.run.controller import Stepper
from mjtactile.run.feelers import Feelers, default_count
from mjtactile.run.loop import WAIT_TIME, Cycle, patient_read, run_loop
from mjtactile.run.perceive import Perceiver
from mjtactile.run.supervisor import Supervisor
from mjtactile.sensing.chain import Perception
from mjtactile.sensing.settings import DEFAULTS, Settings

REFERENCE_IMAGES = 10  # averaging ten takes the reference's noise to a third of an image's
SETTLE_TIME = 0.5  # s for the membrane to come to rest after the valve moved

Say = Callable[[str], None]
Shots = list[list[Image]]
"""Images of every finger."""


class ReferenceRecorder(Protocol):
    """Keeps the names of the fingers, the sensing chain's settings, and the images that the
    references were taken from."""

    def note(self, **values: Any) -> None: ...
    def add_reference(
        self, stage: str, images: Shots, pressure_gauge: list[float | None]
    ) -> None: ...


class Session:
    """A rig and what its sensors know of themselves; `perceptions` are made here, with `settings`,
    unless they are given. They work in `feelers`, where there are any, else `threads` of them
    beside the loop (None: as many as are worth it here).

    Whoever builds the rig closes it: `open_session` does both.
    """

    def __init__(
        self,
        rig: Rig,
        perceptions: Sequence[Perceiver] | None = None,
        *,
        settings: Settings = DEFAULTS,
        threads: int | None = None,
        feelers: Feelers | None = None,
        say: Say = lambda _: None,
    ):
        self.rig = rig
        self.settings = settings
        self._threads = threads
        self._feelers = feelers
        self._say = say
        self._supervisor = Supervisor(rig.period)
        self.perceptions: Sequence[Perceiver] = (
            [
                Perception.of(finger.design, finger.calibration, settings=settings)
                for finger in rig.fingers
            ]
            if perceptions is None
            else perceptions
        )

    @property
    def patience(self) -> float:
        """s that this world waits for a disk that is behind: a real one does not."""
        return 0.0 if math.isfinite(self.rig.host_timeout) else WAIT_TIME

    def take_references(self, recorder: ReferenceRecorder | None = None) -> None:
        """Let every sensor measure itself: flat with the valve open to the air, then inflated,
        sealed, touching nothing.

        `recorder` keeps the images that it was done with.

        Raises DeviceError when what the cameras see does not agree with the sensor file.
        """
        rig = self.rig
        if recorder is not None:
            recorder.note(
                fingers=[finger.name for finger in rig.fingers],
                settings=self.settings.to_dict(),
                **({"simulated": rig.simulated} if rig.simulated else {}),
            )
        self._say_what_was_measured(recorder)
        self._say("reference: flat, valve open")
        for valve in rig.valves:
            valve.open(0.0)
        shots = self.settled_images()
        if recorder is not None:
            recorder.add_reference("flat", shots, [0.0 for _ in rig.valves])
        for perception, images in zip(self.perceptions, shots, strict=True):
            perception.take_flat(images)
        self._say("reference: inflated, nothing touching")
        self.inflate()
        shots = self.settled_images()
        pressures = [valve.state().pressure_gauge for valve in rig.valves]
        if recorder is not None:
            recorder.add_reference("rest", shots, pressures)
        measured = iter(pressures)
        for finger, perception, images in zip(rig.fingers, self.perceptions, shots, strict=True):
            gauge = next(measured) if finger.valve is not None else None
            perception.take_rest(images, finger.pressure(gauge))

    def _say_what_was_measured(self, recorder: ReferenceRecorder | None) -> None:
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
        if recorder is not None and known:
            recorder.note(
                calibration={name: calibration.table() for name, calibration in known.items()}
            )

    def inflate(self) -> None:
        """Fill every chamber to its supply's pressure and seal it."""
        for finger in self.rig.fingers:
            if finger.valve is not None:
                finger.valve.open(finger.design.chamber.supply_gauge)
        self.rig.clock.wait_until(self.rig.clock.now() + SETTLE_TIME)
        for valve in self.rig.valves:
            valve.close()

    def settled_images(self) -> Shots:
        """Wait until everything is still, then return REFERENCE_IMAGES images of each camera."""
        rig = self.rig
        rig.clock.wait_until(rig.clock.now() + SETTLE_TIME)
        shots: Shots = [[] for _ in rig.fingers]
        for _ in range(REFERENCE_IMAGES):
            signals.check()
            for camera, images in zip(rig.cameras, shots, strict=True):
                images.append(patient_read(rig, camera))
            rig.clock.wait_until(rig.clock.now() + rig.period)
        return shots

    def run(
        self,
        controller: Stepper,
        *,
        time_limit: float,
        on_cycle: Callable[[Cycle], None],
        on_images: Callable[[], None] = lambda: None,
        supervisor: Supervisor | None = None,
    ) -> Command:
        """Run the controller until it says "done" or "abort"; see `mjtactile.run.loop.run_loop`."""
        self._supervisor = Supervisor(self.rig.period) if supervisor is None else supervisor
        with signals.deferred() as stop:
            return run_loop(
                self.rig,
                self.perceptions,
                controller,
                time_limit=time_limit,
                on_cycle=on_cycle,
                on_images=on_images,
                supervisor=self._supervisor,
                stop=stop,
                threads=self._threads,
                feelers=self._feelers,
            )

    def make_safe(self, reason: str) -> None:
        """From the next cycle of `run` on, the hand goes down and opens, whatever the controller
        says. For any thread."""
        self._supervisor.want_safe(reason)


@contextlib.contextmanager
def open_session(
    rig: str,
    design: SensorDesign,
    *,
    object_name: str = "egg",
    seed: int = 0,
    accuracy: str = "",
    effects: str = "auto",
    vary: str = NONE,
    workers: int | None = None,
    settings: Settings = DEFAULTS,
    say: Say = lambda _: None,
) -> Iterator[Session]:
    """Build the rig that the user named, and bring it to its safe state on every way out, which no
    signal cuts short.

    `workers` look at the images beside the loop (None: as many as are worth it here, 0: none):
    threads on a real rig, processes beside a simulated world. Raises InputError for bad names or
    files, DeviceError for a device that is not there, Interrupted.
    """
    with signals.deferred():
        built = build_rig(
            rig,
            design,
            object_name=object_name,
            seed=seed,
            accuracy=accuracy,
            effects=effects,
            vary=vary,
        )
        with contextlib.ExitStack() as stack:
            stack.callback(built.close)
            feelers = _feelers(built, workers)
            if feelers is not None:
                stack.callback(feelers.close)
            yield Session(built, settings=settings, threads=workers, feelers=feelers, say=say)


def _feelers(rig: Rig, workers: int | None) -> Feelers | None:
    """Processes for a simulated rig's fingers; they start while the references are taken. None: no
    use, or no room, for them."""
    count = (
        0
        if rig.scene is None
        else default_count(len(rig.fingers))
        if workers is None
        else min(workers, len(rig.fingers))
    )
    with contextlib.suppress(OSError):
        return Feelers(count) if count > 0 else None
    return None
