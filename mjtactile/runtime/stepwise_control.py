"""`StepwiseControl`: a rig step by step, for whoever has a loop of his own."""

from __future__ import annotations

from collections.abc import Sequence

from mjtactile.core.types import Command, Image, Observation
from mjtactile.recording.observer import Observer
from mjtactile.rig.finger import Rig
from mjtactile.runtime.cycle import ControlCycle
from mjtactile.runtime.perception_threads import Perceiver, Perceivers
from mjtactile.runtime.supervisor import Supervisor


class StepwiseControl:
    """The control cycle, one camera's period a step: `observe`, then `send`.

    As in `Session.run`, supervisor and limits stand between what is wanted and the rig, and the
    world moves on while somebody thinks: a command takes effect one period after the images that
    it rests on. A simulated world waits for the next `observe`; a real one's devices take a loop
    for dead that does not come back in time.

    Attributes:
        images: Of the newest observation, one a finger.
    """

    def __init__(self, rig: Rig, perceptions: Sequence[Perceiver], threads: int | None = None):
        names = [finger.name for finger in rig.fingers]
        self._rig = rig
        self._perceivers = Perceivers(perceptions, names, threads)
        self._cycle = ControlCycle.begin(rig, self._perceivers, Supervisor(rig.period), Observer())
        self._deadline = self._cycle.now
        self._sent = True
        self.images: tuple[Image, ...] = ()

    def observe(self) -> Observation:
        """Wait for the next period, take the images, and feel them.

        Returns:
            What a controller would be shown.

        Raises:
            DeviceError: A device failed; the hand is on its way down.
            SimulationError: The simulated world broke.
        """
        if not self._sent:
            self.send(self._cycle.last)
        rig = self._rig
        rig.clock.wait_until(self._deadline)
        self._cycle.look()
        self._deadline = max(self._deadline, rig.clock.now() - rig.period) + rig.period
        rig.clock.start(self._deadline)
        seen = self._cycle.feel()
        if self._cycle.failure is not None:
            raise self._cycle.failure
        self.images = self._cycle.images
        self._sent = False
        return seen

    def send(self, wanted: Command) -> Command:
        """Ask for something.

        Args:
            wanted: The command.

        Returns:
            What was sent.
        """
        self._sent = True
        return self._cycle.send(wanted)

    def close(self) -> None:
        """Let go of the threads that feel."""
        self._perceivers.__exit__()
