"""The effects a simulation can have: their names, when each is needed, what it costs, and what
leaving it out costs.

    chosen = choose(design, load_object("egg"), force_error=0.02)          # effects="auto"
    chosen = choose(design, item, overrides="+bending,-friction")          # forced by hand
    world = GraspWorld(design, item, effects=chosen.on)

The gates are those of docs/effects.md: an effect is on when leaving it out would move force or
surface by more than the accuracy asked for, or when the scene makes it the point (friction carries
the object). Costs and errors are measured on the shipped membrane by `mjtactile bench effects`
(models/fidelity/effects.json).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from mjtactile.core import resources, theory
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.sim.effects import steepness
from mjtactile.sim.effects.fidelity import DEFAULT_FORCE_ERROR
from mjtactile.sim.scenes.objects import ObjectModel, read_spec
from mjtactile.sim.sensor import features
from mjtactile.sim.sensor.switches import Effect

GRAVITY = 9.81
_CONTACT_SPEED = 0.01  # m/s of the membrane while an object is touched gently
_EXPOSURE = 0.008  # s
_HELD = 0.6  # N: a usual grasp
# of the force, over the slope's tangent squared: what shading moves in the middle, measured
# (docs/effects.md)
_SHADED = 0.06


@dataclass(frozen=True)
class Scene:
    """What the gates look at. `feature` m: the object's smallest radius; `sharp`: it has edges;
    `half_extents` m: half its size along and across a membrane that closes on it."""

    design: SensorDesign
    grasped: ObjectModel | None
    force_error: float
    feature: float
    sharp: bool
    half_extents: tuple[float, float] = (math.inf, math.inf)

    @property
    def bulge(self) -> float:
        """Height of the free bulge at the supply's pressure, m; an estimate outside of the theory's
        table."""
        height = theory.bulge_height(self.design, self.design.chamber.supply_gauge)
        if math.isfinite(height):
            return abs(height)
        return 0.1 * min(self.design.frame.length, self.design.frame.width)

    @property
    def half_width(self) -> float:
        return min(self.design.frame.length, self.design.frame.width) / 2


Gate = Callable[[Scene], tuple[bool, str]]


@dataclass(frozen=True)
class Entry:
    """`name`; `kind` of place it lives in; `gate` that says whether a scene needs it and why;
    `built`: False when this version has no such effect, `fixed` when it cannot be taken out."""

    name: Effect
    kind: str
    gate: Gate
    built: bool = True
    fixed: bool = False


@dataclass(frozen=True)
class Choice:
    """One row of the table: the effect, whether it is on, why, ms per simulated second it costs,
    and what leaving it out costs, N and um (NaN: not measured)."""

    effect: Entry
    on: bool
    why: str
    cost: float
    force: float
    surface: float


@dataclass(frozen=True)
class Chosen:
    """`choices` in the order of the catalogue; `on` the names of those that are on and built."""

    choices: tuple[Choice, ...]

    @property
    def on(self) -> frozenset[Effect]:
        return frozenset(c.effect.name for c in self.choices if c.on and c.effect.built)

    def summary(self) -> list[dict[str, Any]]:
        """One object an effect, for JSON."""
        return [
            {
                "effect": c.effect.name,
                "kind": c.effect.kind,
                "on": c.on,
                "built": c.effect.built,
                "why": c.why,
                "cost_ms_per_s": c.cost,
                "left_out_N": c.force,
                "left_out_um": c.surface,
            }
            for c in self.choices
        ]


def choose(
    design: SensorDesign,
    grasped: ObjectModel | None = None,
    *,
    force_error: float = DEFAULT_FORCE_ERROR,
    overrides: str = "auto",
) -> Chosen:
    """Derive the set for a sensor, an object and a force error asked for (N); then apply
    `overrides`.

    `overrides` is "auto", or "+name,-name,...". Raises InputError for an unknown name, an effect
    that is not built and is forced on, or one that cannot be taken out and is forced off.
    """
    forced = _with_what_goes_along(parse(overrides))
    scene = Scene(design, grasped, force_error, *_feature(grasped))
    measured = _measured()
    choices = []
    for effect in EFFECTS:
        on, why = effect.gate(scene)
        if effect.name in forced:
            auto = _switch(on)
            on = forced[effect.name]
            why = f"forced {_switch(on)} (auto: {auto})"
        row = measured.get(effect.name, {})
        numbers = (_number(row.get(key)) for key in ("cost_ms_per_s", "force_N", "surface_um"))
        choices.append(Choice(effect, on, why, *numbers))
    return Chosen(tuple(choices))


def _switch(on: bool) -> str:
    return "on" if on else "off"


def parse(text: str) -> dict[Effect, bool]:
    """Read "auto" or "+bending,-friction" into name to on. Raises InputError listing the names."""
    forced: dict[Effect, bool] = {}
    for part in [] if text.strip() in ("", "auto") else text.split(","):
        sign = part.strip()[:1]
        name = part.strip()[1:].strip().replace("_", " ")
        effect = next((e for e in EFFECTS if e.name.lower() == name.lower()), None)
        if sign not in ("+", "-") or effect is None:
            raise InputError(
                f"{part.strip()!r} is not +NAME or -NAME",
                field="--effects",
                choices=["auto", *(e.name for e in EFFECTS)],
            )
        if sign == "+" and not effect.built:
            raise InputError(
                f"{effect.name!r} is not in this version: {effect.kind}", field="--effects"
            )
        if sign == "-" and effect.fixed:
            raise InputError(
                f"{effect.name!r} cannot be taken out: it is part of {effect.kind}",
                field="--effects",
            )
        forced[effect.name] = sign == "+"
    return forced


def _with_what_goes_along(forced: dict[Effect, bool]) -> dict[Effect, bool]:
    """Without a chain there is nobody to look at images, and touch is that of a film. Raises
    InputError where the two are forced apart."""
    if forced.get(Effect.CHAIN, True):
        return forced
    if forced.get(Effect.SHEET, True):
        raise InputError(
            "touch is drawn of a film, not of a mesh", field="--effects", choices=["-sheet,-chain"]
        )
    if forced.get(Effect.IMAGES, False):
        raise InputError("nobody looks at images without a chain", field="--effects")
    return forced | {Effect.IMAGES: False}


# -- gates: (needed, why)
# --------------------------------------------------------------------------------


def _gas(s: Scene) -> tuple[bool, str]:
    volume = s.design.chamber_volume_flat
    stiffness = (
        s.design.chamber.heat_ratio * s.design.chamber.ambient * s.design.frame.area**2 / volume
    )
    return True, (
        f"the chamber is sealed in a grasp: {1e-3 * stiffness:.1f} N/mm against piston motion"
    )


def _large_deflection(s: Scene) -> tuple[bool, str]:
    sheet = s.design.membrane
    frame = s.design.frame
    c1, c2 = theory.rectangle_coefficients(
        max(frame.length, frame.width) / (2 * s.half_width), sheet.poisson
    )
    tension = max(sheet.pretension, 1e-9)
    share = c2 / c1 * sheet.young * sheet.thickness / tension * (s.bulge / s.half_width) ** 2
    return _over(share, 0.01, "cubic share of the stiffness")


def _bending(s: Scene) -> tuple[bool, str]:
    limit = 5 * s.design.membrane.thickness
    if s.feature < limit:
        return True, (
            f"a feature of {1e3 * s.feature:.2g} mm is below five thicknesses "
            f"({1e3 * limit:.2g} mm)"
        )
    if s.sharp and s.force_error < 0.005:
        return True, "the object has sharp edges, and less than 5 mN is asked for"
    return False, "no feature below five thicknesses" + (
        "; edges count below 5 mN" if s.sharp else ""
    )


def _friction(s: Scene) -> tuple[bool, str]:
    if s.grasped is None:
        return True, "shear may be applied"
    return True, f"carries the object's weight of {GRAVITY * s.grasped.mass:.2f} N"


def _gravity(s: Scene) -> tuple[bool, str]:
    sheet = s.design.membrane
    frame = s.design.frame
    weight = sheet.density * sheet.thickness * frame.area * GRAVITY / sheet.pre_stretch**2
    return _over(
        weight / s.force_error,
        0.1,
        f"the sheet's weight of {1e3 * weight:.1f} mN over the force error asked for",
    )


def _follower(s: Scene) -> tuple[bool, str]:
    sheet = s.design.membrane
    # a grasp raises it by 1-2 kPa
    pressure = max(abs(s.design.chamber.supply_gauge), 0.02 * s.design.chamber.ambient)
    return _over(pressure * s.half_width / (sheet.young * sheet.thickness), 1e-2, "p a / E h")


def _hyperelastic(s: Scene) -> tuple[bool, str]:
    lower = theory.stvk_height_error(s.design, s.design.chamber.supply_gauge)
    share = f"by {lower:.0%}" if math.isfinite(lower) else "by an unknown share"
    return True, (
        f"rubber softens as it stretches: without, it bulges less {share} at the supply's pressure"
    )


def _heat(s: Scene) -> tuple[bool, str]:
    chamber = s.design.chamber
    on = math.isfinite(chamber.heat_exchange) and chamber.heat_ratio > 1
    if on:
        return True, f"{chamber.heat_exchange:g} s is within a grasp's time"
    return False, "the sensor's gas keeps one exponent"


def _valve(s: Scene) -> tuple[bool, str]:
    chamber = s.design.chamber
    on = math.isfinite(chamber.valve_conductance) or chamber.leak_conductance > 0
    if on:
        return True, "the sensor's valve or leak has a conductance"
    return False, "the sensor's valve is ideal and nothing leaks"


def _relaxation(s: Scene) -> tuple[bool, str]:
    relaxation = s.design.relaxation
    if relaxation is None:
        return False, "the sensor's file has no rubber that relaxes"
    if not relaxation.terms:
        return True, f"the first cycles take {relaxation.softening:.0%} of the stress"
    slowest = float(relaxation.times.max())
    faded = relaxation.quick - 1
    return True, f"{faded:.0%} more than the lasting stress at first, faded after {slowest:g} s"


def _servo(s: Scene) -> tuple[bool, str]:
    period = 1 / s.design.camera.rate
    return period < 0.02, f"the controller acts every {1e3 * period:.0f} ms, a servo's lag is 20 ms"


def _motion_blur(s: Scene) -> tuple[bool, str]:
    camera = s.design.camera
    pixels = camera.fx * s.half_width / camera.distance**2 * _CONTACT_SPEED * _EXPOSURE
    return _over(pixels, 0.5, "px of motion within an exposure at 10 mm/s")


def _latency(s: Scene) -> tuple[bool, str]:
    return False, "the control loop acts one image late already"


def _has(value: float, what: str) -> tuple[bool, str]:
    return (
        value > 0,
        f"the camera's file has {what}" if value > 0 else f"the camera's file has no {what}",
    )


def _shadows(s: Scene) -> tuple[bool, str]:
    """The sheet's deepest slope at a usual grasp, against the LEDs' lowest ray, and by what slopes
    alone do to force."""
    leds = s.design.leds
    frame = s.design.frame
    if not leds.count * leds.falloff:
        return False, "no LEDs that fall off: light from everywhere"
    if leds.ring_radius > s.half_width:
        return True, "the frame's wall stands between the LEDs and the membrane"
    lowest = math.atan2(
        s.design.camera.distance, math.hypot(frame.length, frame.width) / 2 + leds.ring_radius
    )
    slope = steepness.deepest(s.design, s.half_extents, _HELD)
    shaded = _SHADED * _HELD * math.tan(min(slope, lowest)) ** 2
    angles = (
        f"slopes of {math.degrees(slope):.0f} deg at {_HELD:g} N, LEDs from "
        f"{math.degrees(lowest):.0f} deg up"
    )
    if slope > lowest:
        return True, f"{angles}: dents are in their own light"
    return shaded > s.force_error, f"{angles}: no shadow; shading moves {1e3 * shaded:.1f} mN"


def _material(name: str) -> Gate:
    def gate(s: Scene) -> tuple[bool, str]:
        found = s.grasped is not None and s.grasped.material == name
        return found, f"the object is {name}: in its own file" if found else f"no {name} object"

    return gate


def _over(value: float, limit: float, what: str) -> tuple[bool, str]:
    return value > limit, f"{what}: {value:.2g} {'>' if value > limit else '<='} {limit:g}"


EFFECTS: tuple[Entry, ...] = (
    Entry(
        Effect.SHEET,
        "physics",
        lambda s: (True, "without, a film lies on what touches, beside MuJoCo's model"),
    ),
    Entry(Effect.GAS, "physics", _gas),
    Entry(Effect.LARGE_DEFLECTION, "the membrane's elements", _large_deflection, fixed=True),
    Entry(Effect.BENDING, "physics", _bending),
    Entry(Effect.FRICTION, "physics", _friction),
    Entry(Effect.GRAVITY, "physics", _gravity),
    Entry(Effect.FOLLOWER_PRESSURE, "physics", _follower),
    Entry(Effect.HYPERELASTICITY, "membrane", _hyperelastic),
    Entry(Effect.HEAT_EXCHANGE, "chamber", _heat),
    Entry(Effect.VALVE_FLOW, "chamber", _valve),
    Entry(Effect.RELAXATION, "membrane", _relaxation),
    Entry(Effect.SERVO_DYNAMICS, "rig", _servo),
    Entry(Effect.CAMERA_NOISE, "camera", lambda s: _has(s.design.camera.noise_dn, "noise")),
    Entry(Effect.BLUR, "camera", lambda s: _has(s.design.camera.blur_px, "blur")),
    Entry(Effect.MOTION_BLUR, "camera", _motion_blur),
    Entry(
        Effect.DISTORTION,
        "camera",
        lambda s: _has(float(np.abs(s.design.camera.distortion).max()), "distortion"),
    ),
    Entry(
        Effect.REFRACTION,
        "camera",
        lambda s: _has(s.design.glass.thickness * (s.design.glass.refractive_index - 1), "glass"),
    ),
    Entry(
        Effect.LED_SHADING,
        "camera",
        lambda s: _has(s.design.leds.count * s.design.leds.falloff, "LEDs that fall off"),
    ),
    Entry(Effect.SHADOWS, "camera", _shadows),
    Entry(Effect.LATENCY, "camera", _latency),
    Entry(
        Effect.IMAGES,
        "camera",
        lambda s: (True, "without, the markers' ellipses are drawn from their error's bound"),
    ),
    Entry(
        Effect.CHAIN,
        "camera",
        lambda s: (True, "without, touch is drawn: a film's own, with the errors of the chain"),
    ),
    Entry(
        Effect.PLASTICITY,
        "the object's own file (docs/objects.md)",
        _material("amorphous"),
        built=False,
    ),
    Entry(
        Effect.VOLUMETRIC_SOFTNESS,
        "the object's own file (docs/objects.md)",
        _material("soft"),
        built=False,
    ),
)


def film_serves(design: SensorDesign, grasped: ObjectModel, overrides: str) -> bool:
    """Whether `--accuracy` may take a film: nobody has said what the sheet is to be, and it would
    lie on something rigid and round, as what its error was measured on."""
    if Effect.SHEET in parse(overrides) or design.relaxation is not None:
        return False
    return grasped.flesh is None and not _feature(grasped)[1]


def _feature(grasped: ObjectModel | None) -> tuple[float, bool, tuple[float, float]]:
    """Smallest radius of the object, m, whether it has sharp edges, and half its extents across the
    fingers' way, m."""
    if grasped is None:
        return math.inf, False, (math.inf, math.inf)
    model = read_spec(grasped).compile()
    geoms = features.touching_geoms(model)
    kinds = model.geom_type[geoms]
    sharp = np.isin(
        kinds,
        (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_MESH),
    ).any()
    return features.smallest_feature(model)[0], bool(sharp), steepness.half_extents(model, geoms)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _measured() -> dict[str, dict[str, float]]:
    """What `bench effects` wrote, by name; empty when it never ran."""
    path = resources.folder("models/fidelity") / "effects.json"
    if path.is_file():
        return json.loads(path.read_text(encoding="utf-8"))["effects"]
    return {}
