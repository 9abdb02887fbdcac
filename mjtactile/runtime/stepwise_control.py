"""`StepwiseControl`: stepwise control of a rig for a caller with its own loop."""

from __future__ import annotations

from collections.abc import Sequence

from mjtactile.core.errors import InputError
from mjtactile.core.types import Command, Image, Observation
from mjtactile.recording.observer import Observer
from mjtactile.rig.finger import Rig
from mjtactile.runtime.cycle import ControlCycle
from mjtactile.runtime.perception_threads import Perceiver, Perceivers
from mjtactile.runtime.supervisor import Supervisor


class StepwiseControl:
    """Control cycle with one camera period per step: `observe`, then `send`.

    As in `Session.run`, supervisor and limits apply to every command. The world moves on while the
    caller computes, so a command takes effect one period after its images. A simulated world waits
    for the next `observe`. The devices of a real rig stop if the loop does not return in time.

    Args:
        rig: The rig.
        perceptions: Sensing pipeline of each finger.
        threads: Number of perception threads in addition to the loop (None: automatic).
        observer: Observer of every observation.

    Attributes:
        images: Images of the newest observation, one per finger.
    """

    def __init__(
        self,
        rig: Rig,
        perceptions: Sequence[Perceiver],
        threads: int | None = None,
        observer: Observer | None = None,
    ):
        names = [finger.name for finger in rig.fingers]
        self._rig = rig
        self._perceivers = Perceivers(perceptions, names, threads)
        supervisor = Supervisor(rig.period)
        observer = observer or Observer()
        self._cycle = ControlCycle.start(rig, self._perceivers, supervisor, observer)
        self._deadline = self._cycle.now
        self._sent = True
        self._closed = False
        self.images: tuple[Image, ...] = ()

    def observe(self) -> Observation:
        """Wait for the next period, take the images, and return the controller's observation.

        Returns:
            The observation. Without a `send` since the last one, the last command continues.

        Raises:
            DeviceError: A device failed; the gripper is being lowered.
            InputError: The control is closed.
            SimulationError: The simulation failed.
        """
        self._require_open()
        if not self._sent:
            self._cycle.send(self._cycle.last)
        rig = self._rig
        rig.clock.wait_until(self._deadline)
        self._cycle.read_sensors()
        self._deadline = max(self._deadline, rig.clock.now() - rig.period) + rig.period
        rig.clock.advance_towards(self._deadline)
        observation = self._cycle.observe()
        if self._cycle.failure is not None:
            raise self._cycle.failure
        self.images = self._cycle.images
        self._sent = False
        return observation

    def send(self, requested: Command) -> Command:
        """Send a command, once for each observation.

        Args:
            requested: The command.

        Returns:
            The command sent after supervisor and limits.

        Raises:
            InputError: There is no new observation, or the control is closed.
        """
        self._require_open()
        if self._sent:
            text = "there is no new observation: call observe() before each send()"
            raise InputError(text, source="Session.steps")
        self._sent = True
        return self._cycle.send(requested)

    def close(self) -> None:
        """Stop the perception threads. Further calls of the other methods are errors."""
        self._closed = True
        self._perceivers.__exit__()

    def _require_open(self) -> None:
        if self._closed:
            raise InputError("is closed: enter Session.steps() again", source="Session.steps")
