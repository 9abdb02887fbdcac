"""Catalog of the simulation effects: names, activation rules, cost, and error when left out.

    chosen = choose(design, load_object("egg"), force_error=0.02)          # effects="auto"
    chosen = choose(design, item, overrides="+bending,-friction")          # forced by hand
    world = GraspWorld(design, item, effects=chosen.on)

The gates are those of docs/reference/effects.md. An effect is on if leaving it out would change
force or surface too much. The limit is the requested accuracy. It is also on if the scene depends
on it (friction carries the object). Costs and errors are measured on the shipped membrane by
`mjtactile bench effects` (models/fidelity/effects.json).
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core import resources
from mjtactile.core.design import SensorDesign
from mjtactile.core.effect_names import Effect, read_switches
from mjtactile.core.errors import InputError
from mjtactile.sim.effects import activation_rules
from mjtactile.sim.effects.activation_rules import Gate, Scene
from mjtactile.sim.effects.fidelity import DEFAULT_FORCE_ERROR
from mjtactile.sim.scenes.objects import ObjectModel, read_spec
from mjtactile.sim.sensor import feature_size, sharp_geoms


@dataclass(frozen=True)
class EffectEntry:
    """Catalog entry: `name`, the part (`kind`) that implements it, and the activation rule `gate`.

    `built` is False if this version has no such effect, `fixed` if it cannot be left out.
    """

    name: Effect
    kind: str
    gate: Gate
    built: bool = True
    fixed: bool = False


@dataclass(frozen=True)
class Choice:
    """One row of the table: the effect, its state, the reason, its cost and the error without it.

    The cost is in ms per simulated second, the error in N and um (NaN: not measured).
    """

    effect: EffectEntry
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
        """Return one JSON object per effect."""
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
    """Choose the effects for a sensor, an object and a force error (N); then apply `overrides`.

    `overrides` is "auto", or "+name,-name,...". Raises InputError for an unknown name, an unbuilt
    effect forced on, or a required one forced off.
    """
    forced = _with_implied(parse(overrides))
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
    forced = read_switches(text, "--effects")
    for effect in EFFECTS:
        if effect.name not in forced:
            continue
        if forced[effect.name] and not effect.built:
            raise InputError(
                f"'{effect.name}' is not in this version: {effect.kind}", field="--effects"
            )
        if not forced[effect.name] and effect.fixed:
            raise InputError(
                f"'{effect.name}' cannot be left out: it is part of {effect.kind}",
                field="--effects",
            )
    return forced


def _with_implied(forced: dict[Effect, bool]) -> dict[Effect, bool]:
    """Add the overrides implied by leaving out the sensing pipeline. Raises InputError."""
    if forced.get(Effect.PIPELINE, True):
        return forced
    if forced.get(Effect.MESH, True):
        raise InputError(
            "synthetic touch needs the quasi-static membrane",
            field="--effects",
            choices=["-mesh,-pipeline"],
        )
    if forced.get(Effect.IMAGES, False):
        raise InputError("images are not used without the sensing pipeline", field="--effects")
    return forced | {Effect.IMAGES: False}


def _always(why: str) -> Gate:
    return lambda scene: (True, why)


_OBJECT_FILE = "the object's own file (docs/reference/object_files.md)"
EFFECTS: tuple[EffectEntry, ...] = (
    EffectEntry(
        Effect.MESH,
        "physics",
        _always("without it, a quasi-static membrane rests on the objects, outside MuJoCo's model"),
    ),
    EffectEntry(Effect.GAS, "physics", activation_rules.gas),
    EffectEntry(
        Effect.LARGE_DEFLECTION,
        "the membrane's elements",
        activation_rules.large_deflection,
        fixed=True,
    ),
    EffectEntry(Effect.BENDING, "physics", activation_rules.bending),
    EffectEntry(Effect.FRICTION, "physics", activation_rules.friction),
    EffectEntry(Effect.GRAVITY, "physics", activation_rules.gravity),
    EffectEntry(Effect.FOLLOWER_PRESSURE, "physics", activation_rules.follower),
    EffectEntry(Effect.HYPERELASTICITY, "membrane", activation_rules.hyperelastic),
    EffectEntry(Effect.HEAT_EXCHANGE, "chamber", activation_rules.heat),
    EffectEntry(Effect.VALVE_FLOW, "chamber", activation_rules.valve),
    EffectEntry(Effect.RELAXATION, "membrane", activation_rules.relaxation),
    EffectEntry(Effect.SERVO_DYNAMICS, "rig", activation_rules.servo),
    EffectEntry(
        Effect.CAMERA_NOISE,
        "camera",
        lambda s: activation_rules.has(s.design.camera.noise_dn, "noise"),
    ),
    EffectEntry(
        Effect.BLUR, "camera", lambda s: activation_rules.has(s.design.camera.blur_px, "blur")
    ),
    EffectEntry(Effect.MOTION_BLUR, "camera", activation_rules.motion_blur),
    EffectEntry(Effect.DISTORTION, "camera", activation_rules.distortion),
    EffectEntry(Effect.REFRACTION, "camera", activation_rules.refraction),
    EffectEntry(Effect.LED_SHADING, "camera", activation_rules.led_shading),
    EffectEntry(Effect.SHADOWS, "camera", activation_rules.shadows),
    EffectEntry(Effect.LATENCY, "camera", activation_rules.latency),
    EffectEntry(
        Effect.IMAGES,
        "camera",
        _always("without it, the marker ellipses are sampled from the bound on their error"),
    ),
    EffectEntry(
        Effect.PIPELINE,
        "camera",
        _always(
            "without it, touch is that of a quasi-static membrane with sampled pipeline errors"
        ),
    ),
    EffectEntry(
        Effect.PLASTICITY, _OBJECT_FILE, activation_rules.material("amorphous"), built=False
    ),
    EffectEntry(
        Effect.VOLUMETRIC_SOFTNESS, _OBJECT_FILE, activation_rules.material("soft"), built=False
    ),
)


def quasistatic_is_valid(design: SensorDesign, grasped: ObjectModel, overrides: str) -> bool:
    """Return True if `--accuracy` may choose a quasi-static membrane: a rigid, round object."""
    if Effect.MESH in parse(overrides) or design.relaxation is not None:
        return False
    return grasped.flex_material is None and not _feature(grasped)[1]


def _feature(grasped: ObjectModel | None) -> tuple[float, bool, tuple[float, float]]:
    """Return the object's smallest radius, m, its sharpness, and its half-extents, m."""
    if grasped is None:
        return math.inf, False, (math.inf, math.inf)
    model = read_spec(grasped).compile()
    geoms = feature_size.touching_geoms(model)
    sharp = bool(np.isin(model.geom_type[geoms], sharp_geoms.KINDS).any())
    half_extents = activation_rules.half_extents(model, geoms)
    return feature_size.smallest_feature(model)[0], sharp, half_extents


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _measured() -> dict[str, dict[str, float]]:
    """Return the results of `bench effects` by name; empty if it never ran."""
    path = resources.folder("models/fidelity") / "effects.json"
    if path.is_file():
        return json.loads(path.read_text(encoding="utf-8"))["effects"]
    return {}
