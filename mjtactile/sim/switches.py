"""The switches behind the effects: what each adds to, or takes out of, model, run time and camera. No policy; see effects.py.

An effect that is off leaves no element in the model and no call per step. A set of effects is a frozenset of names.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from mjtactile import theory
from mjtactile.design import Chamber, SensorDesign
from mjtactile.sim.chamber import ChamberGeometry, GasTendon
from mjtactile.sim.gas import Gas
from mjtactile.sim.membrane import FLEX, TENDON
from mjtactile.sim.mesh import MembraneMesh
from mjtactile.types import Array

PHYSICS = frozenset({"gas", "friction", "gravity", "follower pressure"})
"""What a membrane does when nobody says otherwise."""
CAMERA = frozenset({"camera noise", "blur", "distortion", "refraction", "LED shading"})
"""What a camera shows when nobody says otherwise."""
SERVO_LAG = 0.02
"""Time constant, s, of the current loop and gear of a small servo (docs/effects.md)."""
_STRETCH, _BOTH = 2, 3  # MuJoCo `elastic2d`
_WEIGHTLESS = 1e-12  # kg; MuJoCo wants some mass, the inertia itself is kept as armature


def set_physics(child: mujoco.MjSpec, mesh: MembraneMesh, on: frozenset[str]) -> None:
    """Bring a fresh membrane (of `add_membrane`) to the effects `on`."""
    flex = next(flex for flex in child.flexes if flex.name == FLEX)
    flex.elastic2d = _BOTH if "bending" in on else _STRETCH
    if "gas" not in on:
        child.delete(child.tendon(TENDON))
    if "friction" not in on:
        flex.condim = 1
        for v in mesh.interior:
            child.geom(f"v{v}").condim = 1
    if "gravity" not in on:
        for v in mesh.interior:
            _make_weightless(child.body(f"v{v}"))


def set_servo(spec: mujoco.MjSpec, actuator: str, on: frozenset[str]) -> None:
    """Let `actuator` follow its control with the lag of a real servo, if "servo dynamics" is on."""
    if "servo dynamics" in on:
        servo = spec.actuator(actuator)
        servo.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
        servo.dynprm = [SERVO_LAG, *[0.0] * (len(servo.dynprm) - 1)]


def set_design(design: SensorDesign, on: frozenset[str]) -> SensorDesign:
    """The design without what is off in the sheet's law, the chamber and the camera's geometry: for simulator *and* sensing."""
    membrane, chamber, camera, glass = design.membrane, design.chamber, design.camera, design.glass
    if "hyperelastic correction" in on:
        membrane = replace(membrane, young=theory.neo_hookean_young(design, chamber.supply_gauge))
    if "heat exchange" not in on:
        chamber = replace(chamber, heat_exchange=math.inf)
    if "valve flow" not in on:
        chamber = replace(chamber, valve_conductance=math.inf, leak_conductance=0.0)
    if "distortion" not in on:
        camera = replace(camera, distortion=(0.0,) * 5)
    if "refraction" not in on:
        glass = replace(glass, refractive_index=1.0)
    return replace(design, membrane=membrane, chamber=chamber, camera=camera, glass=glass)


def set_picture(design: SensorDesign, on: frozenset[str]) -> SensorDesign:
    """The design as the renderer draws it: without the noise, blur or shading that is off. Sensing keeps its own."""
    camera, leds = design.camera, design.leds
    camera = replace(camera, noise_dn=camera.noise_dn if "camera noise" in on else 0.0,
                     blur_px=camera.blur_px if "blur" in on else 0.0)
    leds = leds if "LED shading" in on else replace(leds, count=0)
    return replace(design, camera=camera, leds=leds)


class FixedLoad:
    """In place of the gas tendon when "gas" is off: a pressure that does not depend on the volume. Adds no element."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, first_joint: int, count: int):
        self._data, self._last = data, (math.nan, None)
        qpos, dof = int(model.jnt_qposadr[first_joint]), int(model.jnt_dofadr[first_joint])
        self.dofs = slice(dof, dof + count)
        self.displacements: Array = np.asarray(data.qpos)[qpos:qpos + count]

    def apply(self, pressure_gauge: float, stiffness: float, gradient: Array) -> None:
        """Write the load, if it changed."""
        if self._last != (pressure_gauge, id(gradient)):
            self._last = (pressure_gauge, id(gradient))
            self._data.qfrc_applied[self.dofs] = pressure_gauge * gradient.ravel()

    def suspend(self) -> None:
        """Take the load away; the vertices are held otherwise."""
        self._data.qfrc_applied[self.dofs] = 0.0

    def resume(self) -> None:
        """Let the next `apply` write it again."""
        self._last = (math.nan, None)


class FixedGas(Gas):
    """When "gas" is off: the closed valve keeps the pressure that was there, whatever the volume."""

    def advance(self, volume: float, elapsed: float) -> None:
        if self.is_open:
            super().advance(volume, elapsed)

    def stiffness(self, step: float) -> float:
        return 0.0


class FlatGeometry:
    """In place of `ChamberGeometry` when "follower pressure" is off: pressure pushes along z, volume is area x height."""

    def __init__(self, mesh: MembraneMesh, volume_flat: float):
        self._interior, self._volume_flat = mesh.interior, volume_flat
        self._volume, self._gradient = ChamberGeometry(mesh, volume_flat).volume_and_gradient(mesh.p_SV)

    def volume_and_gradient(self, p_SV: Array) -> tuple[float, Array]:
        return self._volume + float(self._gradient[:, 2] @ p_SV[self._interior, 2]), self._gradient


def make_geometry(mesh: MembraneMesh, volume_flat: float, on: frozenset[str]) -> Any:
    return ChamberGeometry(mesh, volume_flat) if "follower pressure" in on else FlatGeometry(mesh, volume_flat)


def make_gas(chamber: Chamber, on: frozenset[str]) -> Gas:
    return Gas(chamber) if "gas" in on else FixedGas(chamber)


def make_load(model: mujoco.MjModel, data: mujoco.MjData, mesh: MembraneMesh, prefix: str, on: frozenset[str]) -> Any:
    """What carries the pressure onto the membrane: the implicit gas tendon, or a fixed load."""
    if "gas" in on:
        return GasTendon(model, data, model.tendon(prefix + TENDON).id)
    return FixedLoad(model, data, model.joint(f"{prefix}v{mesh.interior[0]}x").id, 3 * len(mesh.interior))


def _make_weightless(vertex: mujoco.MjsBody) -> None:
    mass, vertex.mass = float(vertex.mass), _WEIGHTLESS
    vertex.inertia = [1e-14] * 3
    for joint in vertex.joints:
        joint.armature += mass
