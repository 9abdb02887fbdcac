"""`Liquid`: water in an object that sloshes, as one mass on springs.

The first lateral mode of an upright cylinder: Dodge, The New "Dynamic Behavior of Liquids in Moving
Containers", Southwest Research Institute 2000, Eqs. 1.13 to 1.20 and 2.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from mjtactile.core.types import Array

GRAVITY = 9.81  # m/s^2
DENSITY = 1000.0  # of water, kg/m^3
VISCOSITY = 1e-6  # kinematic, of water, m^2/s
NAME = "liquid"
"""Names of the MuJoCo bodies of a liquid start with it."""
_ROOT = 1.841  # first zero of the derivative of the Bessel function J1
_SPIN = 0.1  # fraction of the inertia of a rigid cylinder: most of a liquid does not rotate


@dataclass(frozen=True)
class Liquid:
    """Liquid of `mass` kg in a cylinder of `radius` m, `depth` m deep.

    `center` (3,) m is that of the liquid at rest, in the frame of the object's file.
    """

    mass: float
    radius: float
    depth: float
    center: tuple[float, float, float]

    @property
    def moving_mass(self) -> float:
        """Sloshing part of the mass, kg."""
        ratio = self.depth / self.radius
        return self.mass * math.tanh(_ROOT * ratio) / (2.199 * ratio)

    @property
    def frequency(self) -> float:
        """Frequency of the first mode, rad/s."""
        wave = _ROOT / self.radius
        return math.sqrt(GRAVITY * wave * math.tanh(wave * self.depth))

    @property
    def damping_ratio(self) -> float:
        """Damping ratio of the first mode, by the viscosity at the wall, deep liquid."""
        return 0.79 * math.sqrt(VISCOSITY / math.sqrt(GRAVITY * self.radius**3))

    @property
    def moving_height(self) -> float:
        """Height of the sloshing mass above the center of the liquid, m."""
        ratio = self.depth / self.radius
        return self.depth / 2 - self.radius / _ROOT * math.tanh(_ROOT / 2 * ratio)


def liquid_in(low: Array, high: Array, fill: float) -> Liquid:
    """Return the liquid in an object between the corners `low` and `high` (3,), m.

    The cylinder has the object's smaller width. `fill` is the depth over the object's height.
    """
    radius = float(min(high[:2] - low[:2])) / 2
    depth = fill * float(high[2] - low[2])
    x, y = ((high + low) / 2)[:2].tolist()
    mass = DENSITY * math.pi * radius**2 * depth
    return Liquid(mass, radius, depth, (x, y, float(low[2]) + depth / 2))


def add_liquid(body: mujoco.MjsBody, position: Array, R_WO: Array, liquid: Liquid) -> None:
    """Add a liquid to the MuJoCo `body` of a rigid object at `position` with rotation `R_WO`."""
    moving = liquid.moving_mass
    fixed = liquid.mass - moving
    center = R_WO.T @ (np.array(liquid.center) - position)
    up = R_WO.T[:, 2]
    for name, mass, height in (
        ("at rest", fixed, -moving * liquid.moving_height / fixed),
        ("moving", moving, liquid.moving_height),
    ):
        part = body.add_body(name=f"{NAME} {name}", pos=center + height * up)
        part.explicitinertial = True
        part.mass = mass
        across = mass * (3 * liquid.radius**2 + liquid.depth**2) / 12
        part.inertia = _SPIN * across * np.ones(3)
        if name == "moving":
            frequency = liquid.frequency
            for axis in (0, 1):
                part.add_joint(
                    name=f"{NAME} {'xy'[axis]}",
                    type=mujoco.mjtJoint.mjJNT_SLIDE,
                    axis=R_WO.T[:, axis],
                    range=[-liquid.radius, liquid.radius],
                    limited=True,
                    stiffness=mass * frequency**2,
                    damping=2 * liquid.damping_ratio * frequency * mass,
                )
