"""Switches of the effects: additions to, and removals from, model, run time and camera.

The choice of effects is made in sim/effects/catalog.py. An effect that is off leaves no element in
the model and no call per step.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.effect_names import Effect, read_switches
from mjtactile.core.errors import InputError
from mjtactile.core.neo_hookean import Law
from mjtactile.core.sensor_parts import Chamber
from mjtactile.core.types import Array
from mjtactile.sim.sensor.chamber import ChamberGeometry, GasTendon
from mjtactile.sim.sensor.gas import ChamberGas
from mjtactile.sim.sensor.membrane import FLEX, TENDON
from mjtactile.sim.sensor.mesh import MembraneMesh

PHYSICS = frozenset(
    {
        Effect.MESH,
        Effect.GAS,
        Effect.FRICTION,
        Effect.GRAVITY,
        Effect.FOLLOWER_PRESSURE,
        Effect.HYPERELASTICITY,
    }
)
"""Default effects of a membrane."""
CAMERA = frozenset(
    {
        Effect.CAMERA_NOISE,
        Effect.BLUR,
        Effect.DISTORTION,
        Effect.REFRACTION,
        Effect.LED_SHADING,
        Effect.IMAGES,
        Effect.PIPELINE,
    }
)
"""Default effects of a camera."""
SERVO_LAG = 0.02
"""Time constant, s, of the current loop and gear of a small servo (docs/reference/effects.md)."""
# MuJoCo `elastic2d`
_STRETCH = 2
_BOTH = 3
_WEIGHTLESS = 1e-12  # kg; MuJoCo requires a mass, the inertia is kept as armature


def effects_named(
    names: Collection[str] | str, default: frozenset[Effect] = PHYSICS
) -> frozenset[Effect]:
    """Return the effects of these names, or `default` with the changes of a text "+NAME,-NAME".

    Raises InputError for an effect that does not exist.
    """
    if isinstance(names, str):
        switches = read_switches(names, "effects")
        forced = {effect for effect, on in switches.items() if on}
        return frozenset((default | forced) - (switches.keys() - forced))
    for name in names:
        if not isinstance(name, str) or name not in set(Effect):
            raise InputError(f"{name!r} is not an effect", field="effects", choices=Effect)
    return frozenset(map(Effect, names))


def set_physics(child: mujoco.MjSpec, mesh: MembraneMesh, on: frozenset[str]) -> None:
    """Configure a new membrane (of `add_membrane`) for the effects `on`."""
    flex = next(flex for flex in child.flexes if flex.name == FLEX)
    flex.elastic2d = _BOTH if Effect.BENDING in on else _STRETCH
    if Effect.GAS not in on:
        child.delete(child.tendon(TENDON))
    if Effect.FRICTION not in on:
        flex.condim = 1
        for v in mesh.interior:
            child.geom(f"v{v}").condim = 1
    if Effect.GRAVITY not in on:
        for v in mesh.interior:
            _make_weightless(child.body(f"v{v}"))


def set_servo(spec: mujoco.MjSpec, actuator: str, on: frozenset[str]) -> None:
    """Add the lag of a real servo to `actuator`, if "servo dynamics" is on."""
    if Effect.SERVO_DYNAMICS in on:
        servo = spec.actuator(actuator)
        servo.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
        servo.dynprm = [SERVO_LAG, *[0.0] * (len(servo.dynprm) - 1)]


def set_design(design: SensorDesign, on: frozenset[str]) -> SensorDesign:
    """Return the design, for simulator *and* sensing, without the effects that are off."""
    chamber = design.chamber
    camera = design.camera
    glass = design.glass
    if Effect.HEAT_EXCHANGE not in on:
        chamber = replace(chamber, heat_exchange=math.inf)
    if Effect.VALVE_FLOW not in on:
        chamber = replace(chamber, valve_conductance=math.inf, leak_conductance=0.0)
    if Effect.DISTORTION not in on:
        camera = replace(camera, distortion=())
    if Effect.REFRACTION not in on:
        glass = replace(glass, refractive_index=1.0)
    relaxation = design.relaxation if Effect.RELAXATION in on else None
    return replace(
        set_law(design, on), chamber=chamber, camera=camera, glass=glass, relaxation=relaxation
    )


def set_law(design: SensorDesign, on: frozenset[str]) -> SensorDesign:
    """Return the design with St. Venant-Kirchhoff rubber if "hyperelasticity" is off."""
    if Effect.HYPERELASTICITY in on:
        return design
    return replace(design, membrane=replace(design.membrane, law=Law.STVK))


def set_camera_effects(design: SensorDesign, on: frozenset[str]) -> SensorDesign:
    """Return the renderer's design without the noise, blur or shading that is switched off."""
    camera = design.camera
    leds = design.leds
    camera = replace(
        camera,
        noise_dn=camera.noise_dn if Effect.CAMERA_NOISE in on else 0.0,
        blur_px=camera.blur_px if Effect.BLUR in on else 0.0,
    )
    leds = leds if Effect.LED_SHADING in on else replace(leds, count=0)
    return replace(design, camera=camera, leds=leds)


class FixedLoad:
    """Replacement of the gas tendon when "gas" is off: a pressure independent of the volume."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, first_joint: int, count: int):
        self._last = (math.nan, None)
        qpos = int(model.jnt_qposadr[first_joint])
        dof = int(model.jnt_dofadr[first_joint])
        self.dofs = slice(dof, dof + count)
        self.displacements: Array = np.asarray(data.qpos)[qpos : qpos + count]
        self.forces: Array = np.asarray(data.qfrc_applied)[self.dofs]

    def apply(self, gauge_pressure: float, stiffness: float, gradient: Array) -> None:
        """Write the load, if it changed."""
        if self._last != (gauge_pressure, id(gradient)):
            self._last = (gauge_pressure, id(gradient))
            self.forces[:] = gauge_pressure * gradient.ravel()

    def suspend(self) -> None:
        """Remove the load. The sleeping sensor holds the vertices."""
        self.forces[:] = 0.0

    def resume(self) -> None:
        """Apply the load again at the next `apply`."""
        self._last = (math.nan, None)


class FixedGas(ChamberGas):
    """Gas model when "gas" is off: the closed valve keeps the pressure at any volume."""

    def advance(self, volume: float, elapsed: float) -> None:
        if self.is_open:
            super().advance(volume, elapsed)

    def stiffness(self, step: float) -> float:
        return 0.0


class FlatGeometry:
    """Replacement of `ChamberGeometry` without "follower pressure": volume is area x height."""

    def __init__(self, mesh: MembraneMesh, volume_flat: float):
        self._interior = mesh.interior
        self._volume_flat = volume_flat
        self._volume, self._gradient = ChamberGeometry(mesh, volume_flat).volume_and_gradient(
            mesh.p_SV
        )

    def volume_and_gradient(self, p_SV: Array) -> tuple[float, Array]:
        return self._volume + float(self._gradient[:, 2] @ p_SV[self._interior, 2]), self._gradient


def make_geometry(mesh: MembraneMesh, volume_flat: float, on: frozenset[str]) -> Any:
    """Return the model of the gas volume, `volume_flat` m^3 when flat, and of its derivative."""
    if Effect.FOLLOWER_PRESSURE in on:
        return ChamberGeometry(mesh, volume_flat)
    return FlatGeometry(mesh, volume_flat)


def make_gas(chamber: Chamber, on: frozenset[str]) -> ChamberGas:
    """Return the gas model of the chamber."""
    return ChamberGas(chamber) if Effect.GAS in on else FixedGas(chamber)


def make_load(
    model: mujoco.MjModel, data: mujoco.MjData, mesh: MembraneMesh, prefix: str, on: frozenset[str]
) -> Any:
    """Return the pressure load on the membrane: the implicit gas tendon, or a fixed load."""
    if Effect.GAS in on:
        return GasTendon(model, data, model.tendon(prefix + TENDON).id, len(mesh.interior))
    return FixedLoad(
        model, data, model.joint(f"{prefix}v{mesh.interior[0]}x").id, 3 * len(mesh.interior)
    )


def _make_weightless(vertex: mujoco.MjsBody) -> None:
    mass = float(vertex.mass)
    vertex.mass = _WEIGHTLESS
    vertex.inertia = [1e-14] * 3
    for joint in vertex.joints:
        joint.armature += mass
