"""Sensors in a user's own scene and Studio: `UserFingers` reads them, `Sensors` attaches and steps
them."""

from __future__ import annotations

import logging
import math
import time as wall
from collections.abc import Mapping, Sequence
from typing import ClassVar

import mujoco
from mujoco.studio import messages, plugin

from mjtactile.core.flags import Flag
from mjtactile.plugin.attach import AttachedSensor, attach
from mjtactile.plugin.sim_finger import SimFinger, step
from mjtactile.sim.attach import configure_options
from mjtactile.studio.callback_guard import guarded
from mjtactile.studio.snapshot import FingerSnapshot, History, StudioSnapshot

_BEHIND = 0.1  # maximum lag, s, that is caught up
_IDLE = 1e-3  # sleep time, s, which lets the viewer's thread run


class UserFingers:
    """Source of snapshots: newest image and touch of fingers that another thread steps."""

    def __init__(self, fingers: Sequence[SimFinger]):
        self._fingers = fingers
        self.history = History()
        self._latest: StudioSnapshot | None = None
        self._seen: tuple[object, ...] = ()

    def snapshot(self) -> StudioSnapshot | None:
        fingers = tuple(self._fingers)
        readings = tuple(finger.seen for finger in fingers)
        if not readings:
            return None
        if any(a is not b for a, b in zip(readings, self._seen, strict=False)) or len(
            readings
        ) != len(self._seen):
            number = 0 if self._latest is None else self._latest.number + 1
            self._seen = readings
            self._latest = StudioSnapshot(
                number,
                max(estimate.image.time for estimate in readings),
                tuple(
                    FingerSnapshot(
                        finger.name,
                        estimate.image,
                        estimate.touch,
                        finger.design,
                        estimate.rest,
                        gauge_pressure=estimate.gauge_pressure,
                        temperature=estimate.temperature,
                        body=finger.sensor.body_id,
                    )
                    for finger, estimate in zip(fingers, readings, strict=True)
                ),
                flags=_flags_of(fingers),
            )
            self.history.add(self._latest)
        return self._latest


def _flags_of(fingers: Sequence[SimFinger]) -> dict[str, Flag]:
    """Return the flags for reduced accuracy of each finger's simulation."""
    return {
        f"{finger.name}: {kind}": flag for finger in fingers for kind, flag in finger.flags.items()
    }


class Sensors(plugin.SimPlugin):
    """Sensors at sites of any model that Studio loads, stepped by the clock.

    Derive a class from it and list the sites:

        class Tips(mjtactile.studio.Sensors):
            sites = {"left_tip": "dense", "right_tip": "dense"}

    It replaces the stepping of Studio's own `StepControl`, and follows its pause and single
    steps.
    """

    sites: ClassVar[Mapping[str, str]] = {}
    """Name of a site to sensor (a shipped name or a file)."""
    fingers: ClassVar[list[SimFinger]]

    def __init_subclass__(cls) -> None:
        cls.fingers = []

    def __init__(self) -> None:
        self._paused = False
        self._single = False
        self._pace: tuple[float, float] | None = None
        self._time = 0.0
        self._flagged: set[str] = set()

    def complain(self, text: str) -> None:
        """Log an error to Studio's console and pause the simulation."""
        logging.getLogger("mjtactile").error(text)
        self._paused = True

    @messages.handler(priority=messages.Priority.USER)
    @guarded
    def on_load_model(self, event: messages.LoadModelEvent) -> bool:
        """Load it, attach the sensors and take their references."""
        if not event.path:
            return False
        spec = mujoco.MjSpec.from_file(event.path)
        configure_options(spec)
        mounts: list[AttachedSensor] = [
            attach(spec, sensor, site=site, prefix=f"{site}/")
            for site, sensor in self.sites.items()
        ]
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        self.fingers[:] = [mount.bind(model, data) for mount in mounts]
        self._pace = None
        self.handle.set_model(model, path=event.path, data=data)
        return True

    @messages.handler(priority=messages.Priority.USER)
    def on_step_control(self, event: messages.StepControlSnapshot) -> None:
        self._paused = event.pause_state != type(event.pause_state).UNPAUSED

    @messages.handler(priority=messages.Priority.USER)
    def on_single_step(self, _: messages.SingleStepEvent) -> None:
        self._single = True

    @messages.handler(priority=messages.Priority.USER)
    @guarded
    def on_step(self, event: messages.StepEvent) -> bool:
        """Run as many steps as the clock requires."""
        wall.sleep(_IDLE)
        model = event.model
        data = event.data
        if not self.fingers or not self.fingers[0].belongs_to(data):
            return False
        if data.time < self._time:  # reset, or an older state was loaded
            for finger in self.fingers:
                finger.reset()
            self._pace = None
        if self._paused and not self._single:
            self._pace = None
            return True
        now = wall.monotonic()
        count = 1
        if self._pace is None or self._single:
            self._pace = (now, float(data.time))
        else:
            ahead = self._pace[1] + (now - self._pace[0]) - float(data.time)
            if ahead > _BEHIND:
                self._pace = (now, float(data.time))
            count = math.floor(min(ahead, _BEHIND) / model.opt.timestep)
        self._single = False
        step(model, data, self.fingers, max(count, 0))
        self._time = float(data.time)
        self._report_flags()
        return True

    def _report_flags(self) -> None:
        """Write each new flag to Studio's console."""
        flags = _flags_of(self.fingers)
        for kind in flags.keys() - self._flagged:
            logging.getLogger("mjtactile").warning("%s: %s", kind, flags[kind])
        self._flagged |= flags.keys()
