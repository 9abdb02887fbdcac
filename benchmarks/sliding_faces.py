"""`mjtactile bench sliding-faces`: steadiness of the force of a face that rests or slides.

A weight slides over the membrane at constant speed. The simulated normal force should be the weight
in every step. Its standard deviation shows contacts that are lost and regained.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from benchmarks.scenes.stress_scenes import FaceWorld

SPEEDS = (0.0, 5e-3, 10e-3, 20e-3, 30e-3, 50e-3)
WEIGHTS = (0.2, 0.6, 2.0)
STEPS = (2.08e-3, 4e-3, 6.67e-3)
SENSOR = "dense"
ALLOWED = 0.02
"""Required standard deviation over the weight."""
_SETTLING = 0.25  # at rest, and again at the speed, s
_DURATION = 0.3


def run(
    out: Path, *, quick: bool = False, notify: Callable[[str], None] = lambda _: None
) -> dict[str, Any]:
    """Slide every weight at every speed and time step; half a minute of a processor.

    Args:
        out: Folder, unused.
        quick: The first weight and the two lowest speeds only.
        notify: Receiver of a message for every weight.

    Returns:
        "rows", one per weight, speed and time step.
    """
    rows = []
    for weight in WEIGHTS[:1] if quick else WEIGHTS:
        notify(f"sliding-faces: {weight:g} N")
        for speed, step in itertools.product(SPEEDS[:2] if quick else SPEEDS, STEPS):
            world = FaceWorld(SENSOR, count=1, weight=weight, speed=speed, timestep=step)
            forces = world.forces(_SETTLING, _DURATION)
            rows.append(
                {
                    "weight_N": weight,
                    "speed_mm_s": 1e3 * speed,
                    "timestep_ms": 1e3 * step,
                    "mean_over_weight": float(forces.mean() / weight),
                    "sd_over_weight": float(forces.std() / weight),
                }
            )
    return {"rows": rows}


def table(result: Mapping[str, Any]) -> str:
    """Return the table in Markdown: one row per speed, one column per weight and time step."""
    rows = result["rows"]
    cells = {
        (row["speed_mm_s"], row["weight_N"], row["timestep_ms"]): row["sd_over_weight"]
        for row in rows
    }
    columns = sorted({(weight, step) for _, weight, step in cells})
    head = " | ".join(f"{weight:g} N, {step:g} ms" for weight, step in columns)
    lines = [
        "Standard deviation of the normal force, % of the weight:",
        "",
        f"| speed, mm/s | {head} |",
        "|---" * (1 + len(columns)) + "|",
    ]
    for speed in sorted({speed for speed, _, _ in cells}):
        deviations = " | ".join(f"{100 * cells[speed, *column]:.3f}" for column in columns)
        lines.append(f"| {speed:g} | {deviations} |")
    met = sum(row["sd_over_weight"] <= ALLOWED for row in rows)
    off = max(abs(row["mean_over_weight"] - 1) for row in rows)
    lines += [
        "",
        "| quantity | result |",
        "|---|---|",
        f"| standard deviation at most {100 * ALLOWED:g} % | {met} of {len(rows)} |",
        f"| largest standard deviation | {100 * max(cells.values()):.2f} % |",
        f"| largest error of the mean | {100 * off:.2f} % |",
    ]
    return "\n".join(lines) + "\n"
