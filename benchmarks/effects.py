"""`mjtactile bench effects`: cost of each effect, and the error from leaving it out.

Each switch is turned off alone and compared with everything on. Measures: ms per simulated second
of two sensors that hold an egg, force and surface of a pressed sphere. Camera effects: ms per
image. Shadows: changes of estimated force and marker positions where shadows occur.

"Nothing behind" checks that all-off leaves no cost. A scene without a sensor is stepped by `World`
and by MuJoCo alone. A membrane with every effect off is compared with one built without effects.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy.run import stamp
from benchmarks.scenes import rigid_pads
from benchmarks.simulation_cases import HOLD_FORCE, SENSOR, attempt, core_ms, hold, in_turns
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.effect_names import Effect
from mjtactile.recording.files import write_json
from mjtactile.runtime.progress import Progress
from mjtactile.sensing.stateful_pipeline import StatefulPipeline
from mjtactile.sim import ground_truth
from mjtactile.sim.effects.catalog import EFFECTS
from mjtactile.sim.rendering.renderer import Renderer
from mjtactile.sim.scenes.grasp_world import GraspWorld
from mjtactile.sim.scenes.indentation import Indenter, PressWorld
from mjtactile.sim.sensor.effect_switches import CAMERA, PHYSICS, set_camera_effects, set_design

_STEP = 1 / 240
_BLOCK = 4  # steps per call, as between two images
_IMAGES = 20  # images averaged per state: the force noise at the maximum depth is 50 mN
_ALL = PHYSICS | CAMERA
_REAL_GAS = {"polytropic_exponent": 1.4, "heat_exchange": 1.0, "valve_conductance": 1e-7}


def run(out: Path, quick: bool = False) -> dict[str, Any]:
    """Measure every switch and write effects_table.json.

    As models/fidelity/effects.json it is the table that `mjtactile effects` reads.
    """
    notify = Progress().message
    design = load_sensor(SENSOR)
    switched = [
        row.name
        for row in EFFECTS
        if row.built
        and not row.fixed
        and row.name not in (Effect.LATENCY, Effect.IMAGES, Effect.MESH)
    ]
    names = [Effect.BENDING, Effect.GAS] if quick else switched
    effects = {}
    for name in names:
        effects[name] = attempt(lambda name=name: _measure(name, design))
        notify(f"{name}: {effects[name]}")
    result = {
        "stamp": stamp(),
        "effects": effects,
        "nothing_left": _remaining_cost(design),
        "date": f"{datetime.date.today():%Y-%m-%d}",
    }
    good = {name: row for name, row in effects.items() if "failed" not in row}
    write_json(out / "effects_table.json", {"stamp": result["stamp"], "effects": good})
    return result


def _measure(name: Effect, design: SensorDesign) -> dict[str, float]:
    """Return the cost of the effect (ms per simulated s) and the change without it (N, um)."""
    if name in (Effect.HEAT_EXCHANGE, Effect.VALVE_FLOW):
        design = replace(design, chamber=replace(design.chamber, **_REAL_GAS))
        base = _ALL | {Effect.HEAT_EXCHANGE, Effect.VALVE_FLOW}
    else:
        base = _ALL
    on = base | {name}
    off = base - {name}
    if name == Effect.SHADOWS:
        return _shadows(design)
    if name in CAMERA or name == Effect.MOTION_BLUR:
        with_it, without = in_turns([_drawer(design, on), _drawer(design, off)], 5)
        return {
            "cost_ms_per_s": 2 * design.camera.rate * (with_it - without),
            "force_N": float("nan"),
            "surface_um": _shift(design, on, off),
        }
    with_it, without = in_turns([_held(design, on).step, _held(design, off).step], 20)
    pressed = [_press(design, effects) for effects in (on, off)]
    moved = np.linalg.norm(pressed[0][1] - pressed[1][1], axis=1)
    if name == Effect.SERVO_DYNAMICS:  # a load without jaws has no comparison
        moved = moved * np.nan
        pressed = [(np.nan, *pressed[0][1:])] * 2
    return {
        "cost_ms_per_s": (with_it - without) / _STEP,
        "force_N": abs(pressed[0][0] - pressed[1][0]),
        "surface_um": 1e6 * float(np.sqrt(np.mean(moved**2))),
    }


def _shadows(design: SensorDesign) -> dict[str, float]:
    """Measure shadows of a small sphere next to the frame, rendered with and without them.

    The depths are 5 mm (39 degrees steep: the slopes are shaded) and 7.5 mm (59 degrees: they cast
    shadows). The cost is that of two cameras' images at the larger depth. The changes of normal
    force and markers (rms) are those of the depth where they are larger.
    """
    world = PressWorld(design, Indenter("sphere", 4e-3), at=(14e-3, 0.4e-3), timestep=_STEP)
    poses = []
    for gauge in (0.0, 1000.0):
        world.inflate(gauge, seal=gauge > 0)
        poses.append(world.marker_poses(0))
    for depth in (2.5e-3, 5e-3, 7.5e-3):
        world.press(depth)
        poses.append(world.marker_poses(0))
    (dear, *sampled), (cheap, *plain) = (
        _estimated(design, poses, shadows) for shadows in (True, False)
    )
    force, moved = (
        np.array(with_shadow) - np.array(other)
        for with_shadow, other in zip(sampled, plain, strict=True)
    )
    rms = np.sqrt(np.nanmean((moved**2).sum(axis=2), axis=1))
    return {
        "cost_ms_per_s": 2 * design.camera.rate * (dear - cheap),
        "force_N": float(np.abs(force[1:]).max()),
        "surface_um": 1e6 * float(rms[1:].max()),
    }


def _estimated(
    design: SensorDesign, poses: list[tuple[np.ndarray, np.ndarray]], shadows: bool
) -> tuple[float, list[float], list[np.ndarray]]:
    """Return the rendering time, ms per image, the mean forces, N, and the marker positions.

    The time is that of the last of `poses` (flat, inflated, then increasing depths). Forces and
    marker positions (N, 3), m, are given for each depth. A marker that is missing in any image is
    NaN.
    """
    renderer = Renderer(design, seed=1, shadows=shadows)
    perception = StatefulPipeline.of(design, contact_shapes=False)
    perception.measure_flat_reference([renderer.render(*poses[0]) for _ in range(_IMAGES)])
    perception.measure_rest_reference([renderer.render(*poses[1]) for _ in range(_IMAGES)], 1000.0)
    forces = []
    places = []
    for pose in poses[2:]:
        touches = [perception.perceive(renderer.render(*pose), 0.0) for _ in range(_IMAGES)]
        positions = np.full((_IMAGES, design.markers.count, 3), np.nan)
        for k, touch in enumerate(touches):
            if touch.markers is not None:
                positions[k, touch.markers.ids] = touch.markers.p_SM
        forces.append(float(np.mean([touch.force_normal for touch in touches])))
        places.append(positions.mean(axis=0))
    return core_ms(lambda: renderer.render(*poses[-1]), 50), forces, places


def _held(design: SensorDesign, effects: frozenset[str]) -> GraspWorld:
    """Simulate a held egg.

    Without friction the object and the gripper stay at the table.
    """
    world = GraspWorld(
        set_design(design, effects), "egg", timestep=_STEP, effects=effects, opening=0.05
    )
    if Effect.FRICTION not in effects:
        world.set_lift_target = lambda height: None  # type: ignore[method-assign]
    return hold(world, settle=0.2)


def _press(design: SensorDesign, effects: frozenset[str]) -> tuple[float, np.ndarray]:
    """Press a sphere; return normal force, N, and marker positions (N, 3), m."""
    world = PressWorld(
        set_design(design, effects),
        Indenter("sphere", 16e-3),
        at=(0.7e-3, 0.4e-3),
        effects=effects,
        timestep=_STEP,
    )
    world.inflate(1000.0, seal=True)
    world.press(2.5e-3)
    return float(-ground_truth.contact_force(world, 0)[2]), world.marker_poses(0)[0]


def _shift(design: SensorDesign, on: frozenset[str], off: frozenset[str]) -> float:
    """Return the marker error, um, if sensing models an optical effect that is absent.

    Only geometry is used.
    """
    from mjtactile.core import optics

    if not {Effect.DISTORTION, Effect.REFRACTION} & (on - off):
        return float("nan")
    cameras = [
        optics.Camera.from_design(d.camera, d.glass)
        for d in (set_design(design, on), set_design(design, off))
    ]
    p_CM = design.markers.p_SM - design.camera.p_SC
    pixels = np.linalg.norm(
        optics.project(cameras[0], p_CM) - optics.project(cameras[1], p_CM), axis=1
    )
    return float(1e6 * np.sqrt(np.mean(pixels**2)) * design.camera.distance / design.camera.fx)


def _drawer(design: SensorDesign, effects: frozenset[str]) -> Callable[[], Any]:
    changed = set_camera_effects(set_design(design, effects), effects)
    renderer = Renderer(changed, seed=0)
    p_SM = design.markers.p_SM
    n_S = np.tile([0.0, 0.0, 1.0], (design.markers.count, 1))
    if Effect.MOTION_BLUR in effects:
        return lambda: renderer.expose(
            np.asarray(
                np.mean(
                    [renderer.irradiance_image(p_SM, n_S) for _ in range(3)],
                    axis=0,
                    dtype=np.float32,
                )
            )
        )
    return lambda: renderer.render(p_SM, n_S)


def _remaining_cost(design: SensorDesign) -> dict[str, Any]:
    """Measure the remaining costs with effects off.

    Bare MuJoCo is compared with `World` without sensors, interleaved. The model's elements are
    counted with all effects off. A sleeping sensor is compared with one that is kept awake.
    """
    world = rigid_pads.hold(design, "egg", _STEP, HOLD_FORCE)

    def bare() -> None:
        for _ in range(_BLOCK):
            rigid_pads.bare_step(world)

    pairs = (
        np.array(
            [
                [core_ms(action, 100) for action in (bare, lambda: world.step(_BLOCK))]
                for _ in range(9)
            ]
        )
        / _BLOCK
    )
    off = GraspWorld(design, "egg", effects=frozenset({Effect.MESH}))
    return {
        "mujoco_us": 1e3 * float(np.min(pairs[:, 0])),
        "world_us": 1e3 * float(np.min(pairs[:, 1])),
        "tendons_all_off": int(off.model.ntendon),
        "activations_all_off": int(off.model.na),
        **_sleep(design),
    }


def _sleep(design: SensorDesign) -> dict[str, float]:
    """Measure the time of a step without contact, us of a core: awake, and asleep."""
    world = PressWorld(design, Indenter("sphere", 16e-3), timestep=_STEP)
    world.inflate(1000.0, seal=True)
    world.lift_off()
    sensor = world.sensors[0]
    times = {True: [], False: []}
    for _ in range(5):
        for sleepy in times:
            sensor.sleepy = sleepy
            world.step(60)
            times[sleepy].append(core_ms(lambda: world.step(_BLOCK), 50) / _BLOCK)
    return {"awake_us": 1e3 * min(times[False]), "asleep_us": 1e3 * min(times[True])}


def table(result: dict[str, Any]) -> str:
    """Format the result as a Markdown table."""
    lines = [
        "| effect | cost, ms per simulated s | force change without it, mN | surface change, um |",
        "|---|---|---|---|",
    ]
    for name, row in result["effects"].items():
        cells = (
            f"failed: {row['failed']} | |"
            if "failed" in row
            else (
                f"{_cell(row['cost_ms_per_s'], '+.0f')} | {_cell(1e3 * row['force_N'])} | "
                f"{_cell(row['surface_um'])}"
            )
        )
        lines.append(f"| {name} | {cells} |")
    bare = result["nothing_left"]
    return "\n".join(lines) + (
        f"\n\nA step of a scene without sensors takes {bare['mujoco_us']:.1f} us in MuJoCo alone, "
        f"{bare['world_us']:.1f} us in `World`, which also checks the state; with one inflated "
        f"sensor without contact {bare['awake_us']:.0f} us awake, {bare['asleep_us']:.0f} us "
        "asleep.\n"
    )


def _cell(value: float, form: str = ".1f") -> str:
    return "-" if value != value else f"{value:{form}}"
