"""What a rig is: a few small Protocols that the simulator, the emulator, the real devices and recordings all meet.

The control loop and everything above it know only these. Nothing here falls back to another backend by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from mjtactile import resources
from mjtactile.design import SensorDesign
from mjtactile.errors import InputError
from mjtactile.rigfile import load_rig_file
from mjtactile.types import Command, GripperState, Image, ValveState


@runtime_checkable
class Camera(Protocol):
    """A sensor's camera."""

    def read(self) -> Image:
        """The newest image, with its time of capture on the rig's clock. Raises DeviceError when it is stale."""
        ...


@runtime_checkable
class Gripper(Protocol):
    """Two fingers and the axis that lifts the hand."""

    def ask(self) -> None:
        """Begin the measurement that the next `state` returns, so that servos answer while a picture is worked on."""
        ...

    def state(self) -> GripperState:
        """Opening, speed, effort, height, with the time of measurement on the rig's clock and its age.

        Measured when `ask` was called, or now if it was not.
        """
        ...

    def command(self, command: Command) -> Command:
        """Send the goals of `command`, limited to what the rig allows; returns what was really sent."""
        ...


@runtime_checkable
class Valve(Protocol):
    """The valve of one chamber."""

    def state(self) -> ValveState:
        """Open or closed, and the pressure, with the time of measurement on the rig's clock and its age."""
        ...

    def open(self, supply_gauge: float) -> None:
        """Connect the chamber to a supply at `supply_gauge` Pa (0 vents it to the ambient air)."""
        ...

    def close(self) -> None:
        """Seal the chamber: from here on the amount of gas is kept."""
        ...


@runtime_checkable
class Clock(Protocol):
    """Monotonic time in s. In simulation, waiting is what makes the world move."""

    def now(self) -> float: ...

    def start(self, time: float) -> None:
        """Let the world move on towards `time` while the caller computes. Real time needs no telling."""
        ...

    def wait_until(self, time: float) -> None: ...


@dataclass(frozen=True)
class Limits:
    """What no controller can exceed: `opening` m (lowest, highest), `speed` m/s of the opening, `force` N of the servo,
    `lift` m (lowest, highest), `lift_speed` m/s."""

    opening: tuple[float, float] = (0.0, 0.12)
    speed: float = 0.1
    force: float = 10.0
    lift: tuple[float, float] = (0.0, 0.15)
    lift_speed: float = 0.1

    def apply(self, wanted: Command, last: Command, period: float) -> Command:
        """The command nearest to `wanted` that keeps the limits, starting from `last` one `period` s ago."""
        def limit(value: float, before: float, speed: float, bounds: tuple[float, float]) -> float:
            step = speed * period
            return min(max(value, before - step, bounds[0]), before + step, bounds[1])

        return Command(
            opening=limit(wanted.opening, last.opening, self.speed, self.opening),
            force_limit=min(max(wanted.force_limit, 0.0), self.force),
            lift_height=limit(wanted.lift_height, last.lift_height, self.lift_speed, self.lift),
            phase=wanted.phase, memory=wanted.memory)


@dataclass(frozen=True)
class Rig:
    """A gripper with one sensor on each finger. `cameras` and `valves` are in the order of the fingers (left, right)."""

    name: str
    design: SensorDesign
    cameras: tuple[Camera, ...]
    valves: tuple[Valve, ...]
    gripper: Gripper
    clock: Clock
    limits: Limits
    close: Callable[[], None]
    """Bring everything to its safe state and let go of it; called on every exit path."""
    scene: Any = None
    """The simulated world, for scoring alone; None on a real rig. Sensing and controllers never see a `Rig`."""

    @property
    def period(self) -> float:
        """Control period, s: one camera frame."""
        return 1.0 / self.design.camera.rate


def build_rig(name: str, design: SensorDesign, *, object_name: str, seed: int, **simulation: str) -> Rig:
    """Build the rig that the user named: "sim", "emulated", "replay:FOLDER", or a rig file (shipped name or FILE.toml).

    `simulation` goes to the simulator (`accuracy`, `effects`); another rig has no use for it.
    Raises InputError for an unknown rig, object or sensor; DeviceError for a device that is not there.
    """
    if name == "sim":
        from mjtactile.sim.rig import build_sim_rig  # lazily, here and below: a real rig needs no simulator

        return build_sim_rig(design, object_name=object_name, seed=seed, **simulation)
    if any(value not in ("", "auto") for value in simulation.values()):
        raise InputError(f"the rig {name!r} is not simulated here", field=" or ".join(f"--{key}" for key in simulation))
    if name.startswith("replay:"):
        from mjtactile.devices.replay import build_replay_rig

        return build_replay_rig(name.removeprefix("replay:"), design)
    if "." not in name and "/" not in name and name not in resources.names("models/rigs", ".toml"):
        raise InputError(f"unknown rig {name!r}", field="--rig", choices=rig_names())
    rig_file = load_rig_file(name)
    if rig_file.emulator is not None:
        from mjtactile.emulator.rig import build_emulated_rig

        return build_emulated_rig(rig_file, design, object_name=object_name, seed=seed)
    from mjtactile.devices.rig import build_device_rig

    return build_device_rig(rig_file, design, name=rig_file.name)


def rig_names() -> list[str]:
    """What a user may write after `--rig`."""
    return ["sim", *resources.names("models/rigs", ".toml"), "FILE.toml", "replay:FOLDER"]
