"""Synthetic grasp with a plausible force curve, for tests that record or plot runs."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mjtactile.core.types import (
    Command,
    Contact,
    GripperState,
    Image,
    Markers,
    Surface,
    Touch,
    Traction,
    ValveState,
)
from mjtactile.recording.writer import Recorder

_SCHEDULE = (
    ("approach", 0.15),
    ("close", 0.2),
    ("regulate", 0.4),
    ("lift", 0.5),
    ("hold", 0.8),
    ("lower", 0.92),
    ("release", 1.0),
)


@dataclass(frozen=True, eq=False)
class FakeCycle:
    time: float
    images: tuple[Image, ...]
    touch: tuple[Touch, ...]
    gripper: GripperState
    valves: tuple[ValveState, ...]
    sent: Command
    perception_ms: float = 3.0


def fake_touch(force: float, time: float) -> Touch:
    """Return a touch with a bulge of 4 mm that is flattened at its center in proportion to `force`,
    N."""
    x = np.linspace(-0.02, 0.02, 21)
    y = np.linspace(-0.015, 0.015, 17)
    gx, gy = np.meshgrid(x, y)
    rest = 0.004 * np.cos(np.pi * gx / 0.04) * np.cos(np.pi * gy / 0.03)
    press = np.exp(-(gx**2 + gy**2) / 0.006**2)
    fraction = 0.0 if not np.isfinite(force) else force
    z = rest - 0.002 * fraction * press
    forces = np.zeros((17, 21, 3))
    forces[..., 2] = -fraction * press / press.sum()
    contact = Contact(fraction > 0.05, 1e-4 * fraction, np.zeros(2), 0.002 * fraction, press > 0.3)
    wrench = np.array([0.0, 0.0, -fraction, 0.0, 0.0, 0.0])
    traction = Traction(x, y, forces, wrench, np.eye(6) * 0.02**2, 1000.0, "fake")
    surface = Surface(x, y, z, 0.0012, 1e-6, 1e-7, 1e-9)
    markers = Markers(np.arange(81), np.zeros((81, 3)), np.zeros((81, 3)), np.zeros((81, 3, 3)))
    return Touch(time, 0.01, force, 0.03, fraction > 0.05, contact, traction, surface, markers)


def fake_image(seed: int, width: int = 160, height: int = 120) -> Image:
    rng = np.random.default_rng(seed)
    return Image(np.clip(rng.normal(150, 20, (height, width)), 0, 255).astype(np.uint8), seed / 30)


def fake_cycle(i: int, count: int = 60, force: float | None = None) -> FakeCycle:
    part = i / count
    time = i / 30
    phase = next(name for name, end in _SCHEDULE if part < end)
    rise = np.clip((part - 0.15) / 0.15, 0, 1) * np.clip((1 - part) / 0.06, 0, 1)
    force = 0.6 * rise + 0.01 * np.sin(i) if force is None else force
    touch = (fake_touch(force, time), fake_touch(force * 1.02, time))
    gripper = GripperState(0.05, 0.0, force, 0.04 * np.clip((part - 0.4) / 0.1, 0, 1))
    valves = (ValveState(False, 1000.0), ValveState(False))
    return FakeCycle(
        time,
        (fake_image(i), fake_image(i + 1000)),
        touch,
        gripper,
        valves,
        Command(0.05, 4.0, 0.0, phase, {"phase_time": time}),
    )


def write_fake_recording(folder: Path, count: int = 60) -> list[FakeCycle]:
    cycles = [fake_cycle(i, count) for i in range(count)]
    with Recorder(
        folder, {"object": "egg", "sensor": "dense", "controller": "gentle", "seed": 0}
    ) as recorder:
        recorder.note(break_force_N=2.5)
        for cycle in cycles:
            force = cycle.touch[0].force_normal
            recorder.add(cycle, force_normal_true=[force * 0.97, force * 0.98])
    return cycles
