"""Effects whose omission changes the fidelity level of a simulation, and the flags of such results.
Levels are never mixed without a flag."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

from mjtactile.core.errors import InputError

ACCURACIES = ("0.02N (a force error)", "realtime")
MIN_FORCE_ERROR = 1e-4
"""Minimum force error that can be required, N. The solver's noise in a grasp is larger."""

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


def read_accuracy(text: str, field: str) -> float | None:
    """Read "0.02N" into a force error, N; None for "realtime". Raises InputError naming `field`."""
    word = text.strip().lower()
    if word in ("realtime", "real-time"):
        return None
    try:
        value = float(word.removesuffix("n").strip())
    except ValueError:
        value = math.nan
    if not word.endswith("n") or not MIN_FORCE_ERROR <= value < math.inf:
        message = f"{text!r} is not an accuracy of at least {MIN_FORCE_ERROR:g} N"
        raise InputError(message, field=field, choices=ACCURACIES)
    return value


def disabled_effects(effects: Collection[str]) -> tuple[str, ...]:
    """Return the entries of LEFT_OUT that are not in `effects` of a simulation."""
    return tuple(name for name in LEFT_OUT if name not in effects)


def fidelity_notes(result: Mapping[str, object]) -> dict[str, str]:
    """Return the notes on the effects omitted in a result, by name. Without a sensing pipeline, the
    note on images does not apply."""
    gone = [name for name in LEFT_OUT if result.get(name) is False]
    return {name: LEFT_OUT[name] for name in gone if name != "images" or "pipeline" not in gone}
