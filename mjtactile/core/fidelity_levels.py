"""Effects whose omission changes the fidelity level of a simulation, and the flags of such results.
Levels are never mixed without a flag."""

from __future__ import annotations

from collections.abc import Collection, Mapping

LEFT_OUT: Mapping[str, str] = {
    "mesh": "omitted: the quasi-static membrane replaced it (--effects -mesh)",
    "pipeline": (
        "omitted: touches were sampled with the errors of the sensing pipeline (--effects "
        "-mesh,-pipeline)"
    ),
    "images": "not rendered: marker positions were sampled with errors instead (--effects -images)",
}
"""Consequence of omitting each effect, by name. A result without the effect has its name with
false."""


def disabled_effects(effects: Collection[str]) -> tuple[str, ...]:
    """Return the entries of LEFT_OUT that are not in `effects` of a simulation."""
    return tuple(name for name in LEFT_OUT if name not in effects)


def fidelity_notes(result: Mapping[str, object]) -> dict[str, str]:
    """Return the notes on the effects omitted in a result, by name. Without a sensing pipeline, the
    note on images does not apply."""
    gone = [name for name in LEFT_OUT if result.get(name) is False]
    return {name: LEFT_OUT[name] for name in gone if name != "images" or "pipeline" not in gone}
