"""Activation rules of the effects: a gate checks a scene and gives its decision and the reason."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core import analytical_solutions
from mjtactile.core.design import SensorDesign
from mjtactile.sim.scenes.objects import ObjectModel


def deepest(design: SensorDesign, half_extents: tuple[float, float], force: float) -> float:
    """Return the membrane slope angle t, rad, at the contact edge of an ellipsoid.

    The ellipsoid has half extents a, b m across and is loaded with `force` F, N:

        F = pi [(a + b) T(t) + a b p] sin(t)^2,
        T = T0 + E h / (1 - nu^2) (1 / cos(t) - 1) / 2                  (Eq. L5)

    The contact extends to the point where the object has this slope. The stretch of the flank
    spreads over twice its length. The error is -4 to +4 degrees for spheres of 4-16 mm up to 1.8 N.
    Their slopes are 21 to 47 degrees in simulation. Next to the frame's wall the slope is
    larger.
    """
    membrane = design.membrane
    a, b = half_extents
    if not math.isfinite(a + b):
        return 0.0
    stiffness = membrane.young * membrane.thickness / (1 - membrane.poisson**2) / 2
    pressure = max(design.chamber.supply_gauge, 0.0)

    def unbalanced(t: float) -> float:
        tension = membrane.pretension + stiffness * (1 / math.cos(t) - 1)
        return math.pi * ((a + b) * tension + a * b * pressure) * math.sin(t) ** 2 - force

    # bisection to machine precision; the force balance increases with the angle
    low = 0.0
    high = 1.5707
    for _ in range(52):
        midpoint = (low + high) / 2
        low, high = (low, midpoint) if unbalanced(midpoint) > 0 else (midpoint, high)
    return high


def half_extents(model: mujoco.MjModel, geoms: NDArray[np.int64]) -> tuple[float, float]:
    """Return half the size of `geoms` along y and z, m; infinite without any."""
    if not len(geoms):
        return math.inf, math.inf
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    rotation = data.geom_xmat[geoms].reshape(-1, 3, 3)
    box = model.geom_aabb[geoms]
    center = data.geom_xpos[geoms] + np.einsum("nij,nj->ni", rotation, box[:, :3])
    extent = np.einsum("nij,nj->ni", np.abs(rotation), box[:, 3:])
    half = ((center + extent).max(axis=0) - (center - extent).min(axis=0)) / 2
    return float(half[1]), float(half[2])


GRAVITY = 9.81
_CONTACT_SPEED = 0.01  # membrane speed at a gentle touch, m/s
_EXPOSURE = 0.008  # exposure time, s
_HELD = 0.6  # force of a typical grasp, N
# relative force error by shading in the center, over the slope's tangent squared; measured
# (docs/reference/effects.md)
_SHADED = 0.06


@dataclass(frozen=True)
class Scene:
    """Input of the gates.

    `feature`, m, is the object's smallest radius. `sharp` is True if it has edges. `half_extents`,
    m, are half its size along and across a membrane that closes on it.
    """

    design: SensorDesign
    grasped: ObjectModel | None
    force_error: float
    feature: float
    sharp: bool
    half_extents: tuple[float, float] = (math.inf, math.inf)

    @property
    def bulge(self) -> float:
        """Height of the free bulge at the supply's pressure, m."""
        height = analytical_solutions.bulge_height(self.design, self.design.chamber.supply_gauge)
        if math.isfinite(height):
            return abs(height)
        return 0.1 * min(self.design.frame.length, self.design.frame.width)

    @property
    def half_width(self) -> float:
        return min(self.design.frame.length, self.design.frame.width) / 2


Gate = Callable[[Scene], tuple[bool, str]]
"""Function of a scene. Returns True if the scene needs the effect, and the reason as a sentence."""


def gas(s: Scene) -> tuple[bool, str]:
    volume = s.design.chamber_volume_flat
    stiffness = (
        s.design.chamber.polytropic_exponent
        * s.design.chamber.ambient
        * s.design.frame.area**2
        / volume
    )
    return True, (
        f"the chamber is sealed in a grasp: {1e-3 * stiffness:.1f} N/mm against piston motion"
    )


def large_deflection(s: Scene) -> tuple[bool, str]:
    membrane = s.design.membrane
    frame = s.design.frame
    c1, c2 = analytical_solutions.rectangle_coefficients(
        max(frame.length, frame.width) / (2 * s.half_width), membrane.poisson
    )
    tension = max(membrane.pretension, 1e-9)
    fraction = (
        c2 / c1 * membrane.young * membrane.thickness / tension * (s.bulge / s.half_width) ** 2
    )
    return _exceeds(fraction, 0.01, "cubic fraction of the stiffness")


def bending(s: Scene) -> tuple[bool, str]:
    limit = 5 * s.design.membrane.thickness
    if s.feature < limit:
        return True, (
            f"a feature of {1e3 * s.feature:.2g} mm is below five thicknesses "
            f"({1e3 * limit:.2g} mm)"
        )
    if s.sharp and s.force_error < 0.005:
        return True, "the object has sharp edges, and the requested force error is below 5 mN"
    return False, "no feature below five thicknesses" + (
        "; edges matter for a force error below 5 mN" if s.sharp else ""
    )


def friction(s: Scene) -> tuple[bool, str]:
    if s.grasped is None:
        return True, "shear may be applied"
    return True, f"carries the object's weight of {GRAVITY * s.grasped.mass:.2f} N"


def gravity(s: Scene) -> tuple[bool, str]:
    membrane = s.design.membrane
    frame = s.design.frame
    weight = membrane.density * membrane.thickness * frame.area * GRAVITY / membrane.pre_stretch**2
    return _exceeds(
        weight / s.force_error,
        0.1,
        f"the membrane's weight of {1e3 * weight:.1f} mN over the requested force error",
    )


def follower(s: Scene) -> tuple[bool, str]:
    membrane = s.design.membrane
    # a grasp raises it by 1-2 kPa
    pressure = max(abs(s.design.chamber.supply_gauge), 0.02 * s.design.chamber.ambient)
    return _exceeds(
        pressure * s.half_width / (membrane.young * membrane.thickness), 1e-2, "p a / E h"
    )


def hyperelastic(s: Scene) -> tuple[bool, str]:
    lower = analytical_solutions.stvk_height_error(s.design, s.design.chamber.supply_gauge)
    fraction = f"by {lower:.0%}" if math.isfinite(lower) else "by an unknown fraction"
    return True, (
        "rubber softens as it stretches: without this effect, the bulge at the supply "
        f"pressure is lower {fraction}"
    )


def heat(s: Scene) -> tuple[bool, str]:
    chamber = s.design.chamber
    on = math.isfinite(chamber.heat_exchange) and chamber.polytropic_exponent > 1
    if on:
        return True, (
            f"the heat exchange time of {chamber.heat_exchange:g} s is within the duration of a "
            "grasp"
        )
    return False, "the sensor's gas has a constant exponent"


def valve(s: Scene) -> tuple[bool, str]:
    chamber = s.design.chamber
    on = math.isfinite(chamber.valve_conductance) or chamber.leak_conductance > 0
    if on:
        return True, "the sensor's valve or leak has a conductance"
    return False, "the sensor's valve is ideal and nothing leaks"


def relaxation(s: Scene) -> tuple[bool, str]:
    relaxation = s.design.relaxation
    if relaxation is None:
        return False, "the sensor file specifies no relaxation"
    if not relaxation.terms:
        return True, f"the first load cycles reduce the stress by {relaxation.softening:.0%}"
    slowest = float(relaxation.times.max())
    faded = relaxation.quick - 1
    return (
        True,
        f"the initial stress is {faded:.0%} above the lasting stress, and decays in {slowest:g} s",
    )


def servo(s: Scene) -> tuple[bool, str]:
    period = 1 / s.design.camera.rate
    return (
        period < 0.02,
        f"the controller acts every {1e3 * period:.0f} ms, the lag of a servo is 20 ms",
    )


def motion_blur(s: Scene) -> tuple[bool, str]:
    camera = s.design.camera
    pixels = camera.fx * s.half_width / camera.distance**2 * _CONTACT_SPEED * _EXPOSURE
    return _exceeds(pixels, 0.5, "px of motion within an exposure at 10 mm/s")


def latency(s: Scene) -> tuple[bool, str]:
    return False, "the control loop already acts one image late"


def has(value: float, quantity: str) -> tuple[bool, str]:
    return (
        value > 0,
        f"the camera's file has {quantity}"
        if value > 0
        else f"the camera's file has no {quantity}",
    )


def distortion(s: Scene) -> tuple[bool, str]:
    return has(float(np.abs(s.design.camera.distortion).max()), "distortion")


def refraction(s: Scene) -> tuple[bool, str]:
    glass = s.design.glass
    return has(glass.thickness * (glass.refractive_index - 1), "glass")


def led_shading(s: Scene) -> tuple[bool, str]:
    leds = s.design.leds
    return has(leds.count * leds.vignetting, "LED vignetting")


def shadows(s: Scene) -> tuple[bool, str]:
    """Compare the steepest membrane slope in a typical grasp with the LEDs' lowest ray."""
    leds = s.design.leds
    frame = s.design.frame
    if not leds.count * leds.vignetting:
        return False, "no LED vignetting: the illumination is uniform"
    if leds.ring_radius > s.half_width:
        return True, "the frame's wall stands between the LEDs and the membrane"
    lowest = math.atan2(
        s.design.camera.distance, math.hypot(frame.length, frame.width) / 2 + leds.ring_radius
    )
    slope = deepest(s.design, s.half_extents, _HELD)
    shaded = _SHADED * _HELD * math.tan(min(slope, lowest)) ** 2
    angles = (
        f"slopes of {math.degrees(slope):.0f} deg at {_HELD:g} N, LED rays from "
        f"{math.degrees(lowest):.0f} deg up"
    )
    if slope > lowest:
        return True, f"{angles}: indentations cast shadows"
    return (
        shaded > s.force_error,
        f"{angles}: no shadow; shading changes the force by {1e3 * shaded:.1f} mN",
    )


def material(name: str) -> Gate:
    def gate(s: Scene) -> tuple[bool, str]:
        found = s.grasped is not None and s.grasped.material == name
        return (
            found,
            f"the object is {name}: modelled in its own file" if found else f"no {name} object",
        )

    return gate


def _exceeds(value: float, limit: float, quantity: str) -> tuple[bool, str]:
    return value > limit, f"{quantity}: {value:.2g} {'>' if value > limit else '<='} {limit:g}"
