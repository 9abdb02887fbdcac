"""Many sensors in one scene: core time of a step with a ball resting on each of them, and with nothing on any (asleep)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import mujoco

from mjtactile.bench.settings import core_ms
from mjtactile.core.design import load_sensor
from mjtactile.sim.attach import attach, recommend_options
from mjtactile.sim.scenes.world import World

COUNTS = (1, 2, 4, 8)
_TIMESTEP, _GAUGE = 4e-3, 1000.0  # s, Pa
_BALL, _MASS = 8e-3, 0.03  # m, kg: pressed with 0.3 N
_SETTLE, _STEPS = 1.2, 100  # s, and steps in each of the bursts


def measure(counts: tuple[int, ...], say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Of each number of sensors, ms a step: `loaded` with a ball on each, `asleep` with none."""
    rows = []
    for count in counts:
        loaded, asleep = row_of(count, loaded=True), row_of(count, loaded=False)
        if not all(sensor.is_asleep for sensor in asleep.sensors):
            raise AssertionError("a sensor that touches nothing is awake")
        ms = {name: core_ms(world.step, 5 * _STEPS) for name, world in (("loaded_ms", loaded), ("asleep_ms", asleep))}
        rows.append({"sensors": count, **ms})
        say(f"{count} sensors: {ms['loaded_ms']:.2f} ms a step with a ball on each, {ms['asleep_ms']:.2f} ms asleep")
    return rows


def row_of(count: int, *, loaded: bool) -> World:
    """So many inflated, sealed sensors in a row that look up, settled; on each a ball, or nothing."""
    design = load_sensor("dense")
    pitch = design.frame.length + 0.03
    spec = mujoco.MjSpec()
    recommend_options(spec, _TIMESTEP)
    attachments = []
    for k in range(count):
        base = spec.worldbody.add_body(name=f"base{k}", pos=[k * pitch, 0, 0])
        base.add_site(name=f"site{k}")
        attachments.append(attach(spec, design, site=f"site{k}", prefix=f"s{k}/"))
        if loaded:
            ball = spec.worldbody.add_body(name=f"ball{k}", pos=[k * pitch, 0, _BALL + 6e-3])
            ball.add_joint(name=f"ball{k}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
            ball.add_geom(size=[_BALL, 0, 0], mass=_MASS)
    world = World(spec, attachments)
    for sensor in world.sensors:
        sensor.open_valve(_GAUGE)
    world.step(round(_SETTLE / _TIMESTEP))
    for sensor in world.sensors:
        sensor.close_valve()
    world.step(round(_SETTLE / _TIMESTEP))
    return world


def table(rows: list[Mapping[str, Any]]) -> str:
    """Markdown."""
    one = rows[0]
    lines = [f"| sensors in a scene | a step, {1e3 * _MASS:.0f} g on each, ms | over one's, each | a step, asleep, ms |",
             "|---|---|---|---|"]
    lines += [f"| {row['sensors']} | {row['loaded_ms']:.2f} | {row['loaded_ms'] / row['sensors'] / one['loaded_ms']:.2f} | "
              f"{row['asleep_ms']:.3f} |" for row in rows]
    return "\n".join(lines)
