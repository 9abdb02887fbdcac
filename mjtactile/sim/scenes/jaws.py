"""Jaws of a simulated rig: conversion between gripper opening and force and actuator values."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from mjtactile.rig.jaw_transmission import LINEAR, JawLaw
from mjtactile.rig.simulated import SimRigFile
from mjtactile.sim.batched_quasistatic_step import Drive
from mjtactile.sim.scenes.actuators import PositionActuator
from mjtactile.sim.scenes.lifts import ActuatorLift, Lift, NoLift


class Jaws:
    """All actuators that open and close; the opening is the sum of their parts.

    For more than two fingers, the opening is twice the mean distance of the fingertips from the
    center. Each of n fingers closes with 2/n of the mean of the actuators' forces, by virtual work.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, rig: SimRigFile):
        self._jaws: list[tuple[PositionActuator, JawLaw]] = [
            (PositionActuator(model, data, jaw.name, str(rig.path)), jaw.transmission)
            for jaw in rig.gripper.actuators
        ]
        self._share = 2 / len(rig.fingers)
        self._force_limit = math.nan
        self.limit_force(rig.gripper.force_max)

    def opening(self) -> float:
        """Return the opening computed from the actuators' lengths, m."""
        return float(sum(law.part(actuator.length) for actuator, law in self._jaws))

    def speed(self) -> float:
        """Rate of change of the opening, m/s; negative while closing."""
        return float(
            sum(law.slope(actuator.length) * actuator.speed for actuator, law in self._jaws)
        )

    def force(self) -> float:
        """Return the closing force on each finger, as indicated by the servo currents, N."""
        forces = [actuator.force / law.slope(actuator.length) for actuator, law in self._jaws]
        return -self._share * sum(forces) / len(forces)

    def limit_force(self, force: float) -> None:
        """Limit the force on each finger to `force` N and to the actuators' maximum."""
        self._force_limit = force
        for actuator, law in self._jaws:
            actuator.limit_force(force / self._share * abs(law.slope(actuator.length)))

    def force_reached(self) -> float:
        """Return the maximum closing force of the model's actuators on each finger, N."""
        forces = [
            actuator.force_reached(-law.slope(actuator.length)) / abs(law.slope(actuator.length))
            for actuator, law in self._jaws
        ]
        return self._share * sum(forces) / len(forces)

    def reach(self, speed: float) -> float:
        """Return the lead of a goal over the opening for the full force at `speed` m/s, m."""
        count = len(self._jaws)
        reaches = []
        for actuator, law in self._jaws:
            slope = abs(law.slope(actuator.length))
            force = 1.2 * actuator.force_limit + actuator.damping * (speed / (count * slope))
            reaches.append(force / actuator.stiffness * slope * count)
        return min(reaches)

    def drive(self, opening: float) -> None:
        """Set the goal of every actuator, shared equally."""
        for actuator, law in self._jaws:
            actuator.set_goal(law.coordinate(opening / len(self._jaws)))

    def drive_with(self, lift: Lift) -> Drive | None:
        """Return jaws and lift as linear coefficients; None if one of them is not linear."""
        known = isinstance(lift, (ActuatorLift, NoLift))
        if not known or not all(law.kind == LINEAR and a.is_linear for a, law in self._jaws):
            return None
        reads = [(q, law.ratio * gear) for a, law in self._jaws for q, gear in a.reads]
        drives = []
        for actuator, law in self._jaws:
            zero, per_length = actuator.control
            per = per_length / law.ratio
            drives.append((actuator.id, zero - per * law.offset, per / len(self._jaws), 0.0))
        if isinstance(lift, ActuatorLift):
            number, zero, per = lift.affine()
            drives.append((number, zero, 0.0, per))
        table = np.array(drives)
        return Drive(
            sum(law.offset for _, law in self._jaws),
            np.array([q for q, _ in reads]),
            np.array([per for _, per in reads]),
            table[:, 0],
            table[:, 1:],
        )

    def refresh_force(self) -> None:
        """Keep the force on the fingers at its limit where the lever changes with the opening."""
        if any(law.kind != "linear" for _, law in self._jaws):
            self.limit_force(self._force_limit)
