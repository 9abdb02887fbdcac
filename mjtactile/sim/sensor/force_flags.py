"""Flags of forces that last for several checks: on frame and carrier, and rough ones."""

from __future__ import annotations

from collections import deque

import mujoco

from mjtactile.core.flags import Reasons
from mjtactile.sim.sensor import carrier_geoms, contact_loads, feature_size
from mjtactile.sim.sensor.quasistatic_sensor import QuasistaticSensor
from mjtactile.sim.sensor.sensor_types import AnySensor

_FRAMED = 0.2  # force on frame or carrier that lasts for 0.1 s, N
# checks in this time; those of quasi-static membranes are rare
_LASTING, _LASTING_QS = 5, 2
# chatter over two checks: fraction of the force, and N
_CHATTER = 0.02
_MIN_CHATTER = 5e-3


class ForceFlags:
    """Forces of the sensors at the last checks, and the largest so far."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, sensors: tuple[AnySensor, ...]):
        self._model = model
        self._data = data
        self._sensors = sensors
        # force at the last checks, N
        is_quasistatic = all(isinstance(sensor, QuasistaticSensor) for sensor in sensors)
        count = _LASTING_QS if is_quasistatic else _LASTING
        self._framed = [deque([0.0] * count, count) for _ in sensors]
        self._bypassed = [deque([0.0] * count, count) for _ in sensors]
        self._chattered = [deque([0.0] * 2, 2) for _ in sensors]  # the same of the chatter
        # by kind, the largest lasting force, N, and its text
        self._largest: dict[str, tuple[float, str]] = {}
        self._carriers = [carrier_geoms.carrier_geoms(model, data, sensor) for sensor in sensors]

    def chatter(self, index: int) -> Reasons:
        """Return a flag if sliding vertices have made the force rough over several checks."""
        sensor = self._sensors[index]
        if isinstance(sensor, QuasistaticSensor):
            return {}
        sd, force = sensor.chatter
        self._chattered[index].append(sd if sd > max(_CHATTER * force, _MIN_CHATTER) else 0.0)
        lasting = min(self._chattered[index])
        if not lasting:
            return {}
        text = (
            f"sliding vertices of sensor {sensor.prefix!r} lose contact: the normal force varies "
            f"from step to step by {1e3 * lasting:.0f} mN (sd) of {force:.2f} N; a timestep of 2 "
            "ms is steadier"
        )
        return {"chatter": self._largest_so_far("chatter", lasting, text)}

    def frame(self, index: int) -> Reasons:
        """Return flags when a sensor's frame or carrier carries force over several checks."""
        sensor = self._sensors[index]
        prefix = sensor.prefix
        frame, blocking = contact_loads.frame_load(self._data, sensor)
        carried, geom = contact_loads.carried_load(self._data, sensor, self._carriers[index])
        self._framed[index].append(frame)
        self._bypassed[index].append(carried)
        obstacle, name = (
            feature_size.name_of(self._model, one) if one >= 0 else "a soft body"
            for one in (blocking, geom)
        )
        texts = {
            "frame_contact": (
                min(self._framed[index]),
                f"the frame of sensor {prefix!r} is blocked by {obstacle!r} with {{:.1f}} N, which "
                "the camera cannot measure; move the contact onto the membrane",
            ),
            "carrier_contact": (
                min(self._bypassed[index]),
                f"{name!r}, to which sensor {prefix!r} is fixed, carries {{:.1f}} N past the "
                "membrane; move the site forward, or set contype and conaffinity of the geom to 0",
            ),
        }
        flags: Reasons = {}
        for kind, (lasting, text) in texts.items():
            if lasting < _FRAMED:
                continue
            flags[kind] = self._largest_so_far(kind, lasting, text.format(lasting))
        return flags

    def _largest_so_far(self, kind: str, lasting: float, text: str) -> str:
        """Return the text of the flag's largest force so far, where `lasting`, N, is the latest."""
        if lasting > self._largest.get(kind, (0.0, ""))[0]:
            self._largest[kind] = lasting, text
        return self._largest[kind][1]
