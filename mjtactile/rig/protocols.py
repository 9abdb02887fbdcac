"""Device protocols, shared by the simulator, the emulator, real devices and recordings.

The control loop and all higher layers use only these.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from mjtactile.core.types import Command, GripperState, Image, ValveState


@runtime_checkable
class CameraDevice(Protocol):
    """A sensor's camera."""

    def read(self) -> Image:
        """Return the newest image, with its time of capture on the rig's clock. Raises DeviceError
        when it is stale."""
        ...


@runtime_checkable
class Gripper(Protocol):
    """Jaws, in any number, and lift of the gripper."""

    def request_state(self) -> None:
        """Start the measurement that the next `state` returns.

        The servos then respond while an image is processed.
        """
        ...

    def state(self) -> GripperState:
        """Return opening, speed, effort and height, with the time of measurement on the rig's clock
        and its age.

        They are measured when `request_state` was called, or now if it was not.
        """
        ...

    def command(self, command: Command) -> Command:
        """Send the goals of `command`, limited to the rig's range. Returns the sent command."""
        ...


@runtime_checkable
class Valve(Protocol):
    """The valve of one chamber."""

    def state(self) -> ValveState:
        """Return valve state and pressure, with the time of measurement on the rig's clock and its
        age."""
        ...

    def open(self, supply_gauge: float) -> None:
        """Connect the chamber to a supply at `supply_gauge` Pa (0 vents it to the ambient air)."""
        ...

    def close(self) -> None:
        """Seal the chamber: from here on the amount of gas is constant."""
        ...

    def regulate_pressure(self, gauge_pressure: float | None) -> None:
        """Regulate the chamber to a pressure sensor reading of `gauge_pressure`, Pa, from now on.

        None stops this and seals the chamber. The call does not wait. It is used only on rigs whose
        `CommandLimits` have a pressure.
        """
        ...


@runtime_checkable
class Clock(Protocol):
    """Monotonic time, s. In simulation, waiting advances the world."""

    def now(self) -> float: ...

    def advance_towards(self, time: float) -> None:
        """Advance a simulated world towards `time` while the caller computes. On a real rig the
        call has no effect."""
        ...

    def wait_until(self, time: float) -> None: ...
