"""`StepwiseControl`: stepwise control of a rig for a caller with its own loop."""

from __future__ import annotations

from collections.abc import Sequence

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

    Attributes:
        images: Images of the newest observation, one per finger.
    """

    def __init__(self, rig: Rig, perceptions: Sequence[Perceiver], threads: int | None = None):
        names = [finger.name for finger in rig.fingers]
        self._rig = rig
        self._perceivers = Perceivers(perceptions, names, threads)
        self._cycle = ControlCycle.start(rig, self._perceivers, Supervisor(rig.period), Observer())
        self._deadline = self._cycle.now
        self._sent = True
        self.images: tuple[Image, ...] = ()

    def observe(self) -> Observation:
        """Wait for the next period, take the images, and return the controller's observation.

        Raises DeviceError if a device failed (the gripper is being lowered), and SimulationError.
        """
        if not self._sent:
            self.send(self._cycle.last)
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
        """Send a command, and return the one sent after supervisor and limits."""
        self._sent = True
        return self._cycle.send(requested)

    def close(self) -> None:
        """Stop the perception threads."""
        self._perceivers.__exit__()
