"""Fault injection. `Faults` stores the active faults; the emulated devices read it.

A fault is set by a command such as `{"fault": "servo_drop", "value": 0.1}`. Its value is a
probability, a magnitude or a switch, as described for each kind. `value` 0 ends it.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field

KINDS: dict[str, str] = {
    "servo_drop": "probability that a servo's reply is lost",
    "servo_corrupt": "probability that a byte of a servo's reply is changed",
    "servo_short": "probability that a reply (valid CRC) carries too few bytes",
    "servo_late": "delay of replies, s",
    "servo_silent": "id of a servo that stops answering",
    "servo_overload": "id of a servo that latches an overload",
    "servo_overheat": "id of a servo that suddenly overheats",
    "servo_brown_out": "id of a servo that restarts by itself",
    "servo_unplug": "1: the servos' USB adapter is unplugged",
    "valve_unplug": "1: the valves' USB adapter is unplugged",
    "valve_stuck": "1: the valves stop moving, but answer as if they moved",
    "valve_sensor": "1: the valve board's pressure sensors fail",
    "valve_restart": "1: the valve board restarts by itself",
    "valve_silent": "1: the valve board does not answer",
    "valve_garbage": "1: the valve board sends invalid answers",
    "puncture": "1: the left membrane leaks to the air",
    "frames_frozen": "1: cameras repeat the same image",
    "frames_dark": "1: the LEDs are off",
    "frames_saturated": "1: glare: the image is white",
    "frames_stopped": "1: the streams stay open but send nothing",
    "frames_late": "delay of images, s",
    "frames_duplicated": "probability that an image is sent twice",
}


@dataclass
class Faults:
    """Active faults by kind; 0 or missing: none. `rng` samples the probabilistic ones."""

    values: dict[str, float] = field(default_factory=dict)
    rng: random.Random = field(default_factory=lambda: random.Random(0))

    def set(self, kind: str, value: float) -> None:
        """Set the value of a fault. Raises KeyError for an unknown kind."""
        if kind not in KINDS:
            raise KeyError(kind)
        self.values[kind] = float(value)

    def get(self, kind: str) -> float:
        return self.values.get(kind, 0.0)

    def occurs(self, kind: str) -> bool:
        """Sample an event with the probability of a fault."""
        chance = self.values.get(kind, 0.0)
        return chance > 0 and self.rng.random() < chance
