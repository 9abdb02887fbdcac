"""Grasps of random objects with varying forces, followed by a lift.

They cover all loads of real grasps, for comparison of estimated touch with ground truth.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.errors import SimulationError
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Array, Command, Observation, Touch
from mjtactile.recording.observer import Observer
from mjtactile.runtime.cycle import Cycle
from mjtactile.runtime.session import Session, open_session
from mjtactile.sim.sensor.quasistatic_sensor import QuasistaticSensor

_FORCE_MIN, _FORCE_MAX = 0.05, 1.5  # range of the grip force, N
_CHANGE_EVERY = 0.4  # period of goal changes, s
_CLOSING = 0.04  # closing speed, m/s
_GAIN = 0.04  # closing speed per missing force, m/s per N
_FASTEST = 0.02  # limit of that speed, m/s
_RISE = 0.03  # lift speed, m/s
_TIME = 3.0  # duration after the first contact of both fingers, s


class Squeezer:
    """Controller with goals sampled from `seed`: a force that changes at random times, and
    heights."""

    path = Path("squeeze.py")

    def __init__(self, seed: int):
        self._rng = np.random.default_rng([seed, 7])
        self._best_start: float | None = None
        self._next = 0.0
        self._goal = 0.0
        self._height = 0.0

    def step(self, observation: Observation) -> Command:
        last = observation.command
        estimated = [touch.force_normal for touch in observation.touch]
        limit = replace(last, force_limit=8.0)
        if not np.isfinite(estimated).all():
            return limit
        now = observation.time
        if self._best_start is None:
            if min(estimated) > _FORCE_MIN:
                self._best_start = now
            opening = last.opening - _CLOSING * observation.period
            return replace(limit, opening=max(opening, 0.0), phase="close")
        if now - self._best_start > _TIME:
            return replace(limit, phase="done", lift_height=0.0)
        if now >= self._next:
            self._next = now + _CHANGE_EVERY
            self._goal = float(np.exp(self._rng.uniform(np.log(_FORCE_MIN), np.log(_FORCE_MAX))))
            self._height = float(self._rng.choice([0.0, 0.02, 0.04]))
        speed = float(np.clip(_GAIN * (np.mean(estimated) - self._goal), -_FASTEST, _FASTEST))
        step = _RISE * observation.period
        height = last.lift_height + float(np.clip(self._height - last.lift_height, -step, step))
        opening = max(last.opening + speed * observation.period, 0.0)
        return replace(limit, opening=opening, lift_height=max(height, 0.0), phase="hold")


@dataclass
class Compared(Observer):
    """Rows of ground truth at each image, and the estimate from that image."""

    rows: list[dict[str, Any]] = field(default_factory=list)

    def start(self, session: Session) -> None:
        self._sensors = session.rig.scene.sensors

    def on_images(self) -> None:
        self._true = [_true(sensor) for sensor in self._sensors]

    def add(self, cycle: Cycle, view: Any = None, **truth: Any) -> None:
        for finger, (true, touch) in enumerate(zip(self._true, cycle.touch, strict=True)):
            self.rows.append({"finger": finger, "time": cycle.time, **true, **_estimated(touch)})


def _true(sensor: QuasistaticSensor) -> dict[str, Any]:
    return {
        "wrench": sensor.present_wrench(),
        "area": sensor.contact_area,
        "centroid": sensor.middle[:2],
        "depth": sensor.depth,
        "slid": sensor.slid,
    }


def _estimated(touch: Touch) -> dict[str, Any]:
    traction = touch.traction
    contact = touch.contact
    slip = touch.slip
    return {
        "status": str(touch.status.code.value),
        "touching": touch.touching,
        "estimated": np.full(6, np.nan) if traction is None else traction.wrench,
        "cov": np.full((6, 6), np.nan) if traction is None else traction.wrench_cov,
        "estimated_area": np.nan if contact is None else contact.area,
        "estimated_centroid": np.full(2, np.nan) if contact is None else contact.centroid,
        "estimated_depth": np.nan if contact is None else contact.depth,
        "slip": "unknown" if slip is None else slip.state,
    }


def squeeze(scenario: Scenario) -> dict[str, Array]:
    """Grip the scenario's object, and compare the estimates with ground truth.

    Args:
        scenario: Scenario; its seed also determines the goals.

    Returns:
        Columns by name, one row for each image of each finger, in order of time; `seed` is among
        them. The rows end where the simulation failed: a quasi-static membrane does not suit every
        contact.

    Raises:
        MjtactileError: The simulation failed before the first row.
    """
    compared = Compared()
    with open_session(scenario, workers=0) as session:
        compared.start(session)
        session.take_references()
        try:
            session.run(Squeezer(scenario.seed), time_limit=20.0, observer=compared)
        except SimulationError:
            if not compared.rows:
                raise
    names = compared.rows[0]
    found = {name: np.array([row[name] for row in compared.rows]) for name in names}
    return found | {"seed": np.full(len(compared.rows), scenario.seed)}
