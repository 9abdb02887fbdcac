"""Fault injection. `Faults` stores the active faults; the emulated devices read it.

A fault is set by a command such as `{"fault": "servo_drop", "value": 0.1}`. Its value is a
probability, a number or a switch, as described for each kind. `value` 0 ends it.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field

KINDS: dict[str, str] = {
    "servo_drop": "probability that a servo's reply is lost",
    "servo_corrupt": "probability that a byte of a servo's reply is changed",
    "servo_short": "probability that a reply (valid CRC) carries too few bytes",
    "servo_late": "s that replies come late",
    "servo_silent": "id of a servo that answers nothing any more",
    "servo_overload": "id of a servo that latches an overload",
    "servo_overheat": "id of a servo that is suddenly too hot",
    "servo_brown_out": "id of a servo that restarts by itself",
    "servo_unplug": "1: the servos' USB adapter is unplugged",
    "valve_unplug": "1: the valves' USB adapter is unplugged",
    "valve_stuck": "1: the valves do not move any more, but answer as if they did",
    "valve_sensor": "1: the valve board's pressure sensors fail",
    "valve_restart": "1: the valve board restarts by itself",
    "valve_silent": "1: the valve board does not answer",
    "valve_garbage": "1: the valve board answers nonsense",
    "puncture": "1: the left membrane leaks to the air",
    "frames_frozen": "1: cameras send the same picture again and again",
    "frames_dark": "1: the LEDs are off",
    "frames_saturated": "1: glare: the picture is white",
    "frames_stopped": "1: the streams stay open but send nothing",
    "frames_late": "s that pictures come late",
    "frames_duplicated": "probability that a picture is sent twice",
}


@dataclass
class Faults:
    """Active faults by kind; 0 or missing: none. `rng` samples the probabilistic ones."""

    values: dict[str, float] = field(default_factory=dict)
    rng: random.Random = field(default_factory=lambda: random.Random(0))

    def set(self, kind: str, value: float) -> None:
        """Raises KeyError for a kind that does not exist."""
        if kind not in KINDS:
            raise KeyError(kind)
        self.values[kind] = float(value)

    def get(self, kind: str) -> float:
        return self.values.get(kind, 0.0)

    def occurs(self, kind: str) -> bool:
        """Throw the dice of a probability."""
        chance = self.values.get(kind, 0.0)
        return chance > 0 and self.rng.random() < chance
