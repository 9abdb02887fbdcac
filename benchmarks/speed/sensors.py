"""Core time of a step of many sensors in one scene, loaded by a ball each or without load
(asleep)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from benchmarks.scenes.sensor_row import row_of
from benchmarks.simulation_cases import core_ms
from mjtactile.core.design import load_sensor
from mjtactile.sim.scenes.world import World

COUNTS = (1, 2, 4, 8)
# time step, s; gauge pressure, Pa
_TIMESTEP = 4e-3
_GAUGE = 1000.0
# radius of a ball, m, and its mass, kg: a load of 0.3 N
_BALL = 8e-3
_MASS = 0.03
# settling time, s; steps in each burst
_SETTLE = 1.2
_STEPS = 100


def measure(counts: tuple[int, ...], notify: Callable[[str], None]) -> list[dict[str, Any]]:
    """Measure a step for each number of sensors, ms: `loaded` with a ball on each, `asleep` with
    none."""
    rows = []
    for count in counts:
        loaded = scene(count, loaded=True)
        asleep = scene(count, loaded=False)
        if not all(sensor.is_asleep for sensor in asleep.sensors):
            raise AssertionError("a sensor that touches nothing is awake")
        ms = {
            name: core_ms(world.step, 5 * _STEPS)
            for name, world in (("loaded_ms", loaded), ("asleep_ms", asleep))
        }
        rows.append({"sensors": count, **ms})
        notify(
            f"{count} sensors: {ms['loaded_ms']:.2f} ms a step with a ball on each, "
            f"{ms['asleep_ms']:.2f} ms asleep"
        )
    return rows


def scene(count: int, *, loaded: bool) -> World:
    """Build `count` settled sensors; if `loaded`, a ball rests on each."""
    return row_of(
        load_sensor("dense"),
        count,
        ball=(_BALL, _MASS) if loaded else None,
        gauge=_GAUGE,
        timestep=_TIMESTEP,
        settle=_SETTLE,
    )


def table(rows: list[Mapping[str, Any]]) -> str:
    """Format the rows as a Markdown table."""
    one = rows[0]
    lines = [
        f"| sensors in a scene | step, {1e3 * _MASS:.0f} g on each, ms | time per sensor / time of "
        "one | step, asleep, ms |",
        "|---|---|---|---|",
    ]
    lines += [
        f"| {row['sensors']} | {row['loaded_ms']:.2f} | "
        f"{row['loaded_ms'] / row['sensors'] / one['loaded_ms']:.2f} | {row['asleep_ms']:.3f} |"
        for row in rows
    ]
    return "\n".join(lines)
