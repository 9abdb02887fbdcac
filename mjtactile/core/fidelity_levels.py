"""What a simulation may leave out that makes its results those of another level, and how results
say so. Nothing mixes levels silently."""

from __future__ import annotations

from collections.abc import Collection, Mapping

LEFT_OUT: Mapping[str, str] = {
    "sheet": "left out: a film lay on what touched, in place of the mesh (--effects -sheet)",
    "chain": "left out: touch was drawn with the chain's errors (--effects -sheet,-chain)",
    "images": "none were drawn: markers with errors drawn in their place (--effects -images)",
}
"""By the effect's name: what its absence means. A result that lacks it has the name with false."""


def disabled_effects(effects: Collection[str]) -> tuple[str, ...]:
    """Which of LEFT_OUT a simulation with `effects` leaves out."""
    return tuple(name for name in LEFT_OUT if name not in effects)


def fidelity_notes(result: Mapping[str, object]) -> dict[str, str]:
    """What a result says that was left out, by name; without a chain there are no markers whose
    images could be."""
    gone = [name for name in LEFT_OUT if result.get(name) is False]
    return {name: LEFT_OUT[name] for name in gone if name != "images" or "chain" not in gone}
