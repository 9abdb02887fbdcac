"""Names of the optional effects of a simulation, and the text that forces them on or off."""

from __future__ import annotations

from enum import StrEnum

from mjtactile.core.errors import InputError
from mjtactile.core.renamed import EFFECTS, hint


class Effect(StrEnum):
    """Optional effects of a simulation; an effect equals its name."""

    MESH = "mesh"
    GAS = "gas"
    LARGE_DEFLECTION = "large deflection"
    BENDING = "bending"
    FRICTION = "friction"
    GRAVITY = "gravity"
    FOLLOWER_PRESSURE = "follower pressure"
    HYPERELASTICITY = "hyperelasticity"
    HEAT_EXCHANGE = "heat exchange"
    VALVE_FLOW = "valve flow"
    RELAXATION = "relaxation"
    SERVO_DYNAMICS = "servo dynamics"
    CAMERA_NOISE = "camera noise"
    BLUR = "blur"
    MOTION_BLUR = "motion blur"
    DISTORTION = "distortion"
    REFRACTION = "refraction"
    LED_SHADING = "LED shading"
    SHADOWS = "shadows"
    LATENCY = "latency"
    IMAGES = "images"
    PIPELINE = "pipeline"
    PLASTICITY = "plasticity"
    VOLUMETRIC_SOFTNESS = "volumetric softness"


def read_switches(text: str, field: str) -> dict[Effect, bool]:
    """Read "auto" or "+bending,-friction" into effect to on. Raises InputError naming `field`."""
    by_name = {effect.lower(): effect for effect in Effect}
    switches: dict[Effect, bool] = {}
    for part in [] if text.strip() in ("", "auto") else text.split(","):
        sign = part.strip()[:1]
        name = part.strip()[1:].strip().replace("_", " ")
        effect = by_name.get(name.lower())
        if sign not in ("+", "-") or effect is None:
            raise InputError(
                f"{part.strip()!r} is not +NAME or -NAME{hint(name, EFFECTS)}",
                field=field,
                choices=["auto", *Effect],
            )
        switches[effect] = sign == "+"
    return switches
