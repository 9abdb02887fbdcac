"""Table of options that need an effect of the simulation, checked before a run.

An option without its effect would return nothing: no image, or zeros.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from mjtactile.core.errors import InputError


@dataclass(frozen=True)
class Requirement:
    """The `value` of an `option` needs an `effect`. `reason` states what is missing without it."""

    option: str
    value: object
    effect: str
    reason: str


REQUIREMENTS = (
    Requirement("render_mode", "rgb_array", "images", "no image is rendered"),
    Requirement("observation", "image", "images", "no image is rendered"),
    Requirement("observation", "markers", "pipeline", "no marker is detected"),
    Requirement("contact_shapes", True, "pipeline", "no contact shape is estimated"),
    Requirement("REQUIRES", "contact_shape", "pipeline", "no contact shape is estimated"),
)


def require_effects(effects: Collection[str], source: object, **options: Any) -> None:
    """Check options against the effects of a simulation.

    Args:
        effects: Effects that are on.
        source: Source of the options in messages.
        **options: Values by option; options without a requirement are ignored.

    Raises:
        InputError: An option needs an effect that is off.
    """
    for need in REQUIREMENTS:
        if options.get(need.option) == need.value and need.effect not in effects:
            raise InputError(
                f"{need.value!r} needs the effect {need.effect!r}: without it {need.reason}; "
                f"remove -{need.effect} from the effects",
                source=source,
                field=need.option,
            )
