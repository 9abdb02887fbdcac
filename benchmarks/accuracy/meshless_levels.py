"""`mjtactile bench meshless`: simulation levels without a mesh, measured like `bench accuracy`.

The same spheres are pressed and compared with the same finest mesh, and the same egg is held. For
synthetic touch the error is that of the estimated force, not of the simulated one. Then episodes of
`gentle` run with the same seeds, with all effects and at each level. The result counts the equal
outcomes. The output models/fidelity/levels.json is the table from which `--accuracy` chooses a
quasi-static membrane.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy.run import _QUICK_REFERENCE, _REFERENCE, stamp
from benchmarks.simulation_cases import CASES, SENSOR, Case, Pressed, Setting, core_ms, hold, press
from mjtactile.core.design import load_sensor
from mjtactile.core.effect_names import Effect
from mjtactile.core.scenario import Scenario
from mjtactile.evaluate.episodes import Episode, run_episode
from mjtactile.recording.files import write_json
from mjtactile.runtime.progress import Progress
from mjtactile.sim import ground_truth
from mjtactile.sim.effects.fidelity import levels_path
from mjtactile.sim.scenes.grasp_world import GraspWorld
from mjtactile.sim.scenes.indentation import Indenter, PressWorld
from mjtactile.sim.sensing_error_model import load_errors
from mjtactile.sim.sensor.effect_switches import PHYSICS
from mjtactile.sim.sensor.quasistatic_geoms import QS_GRID
from mjtactile.sim.synthetic_touch import SyntheticTouchSource

STEP = 1 / 480  # time step of a rig with quasi-static membranes, s
FIRST_SEED = 9400  # not used for fits or tuning
PAIRS, PAIRS_QUICK = 12, 1
QUASISTATIC, SAMPLED = "-mesh", "-mesh,-pipeline"
_SAMPLES = 400
_WITHOUT = PHYSICS - {Effect.MESH}

Notify = Callable[[str], None]


def run(
    out: Path, *, quick: bool = False, pairs: int | None = None, notify: Notify | None = None
) -> dict[str, Any]:
    """Measure both levels. Unless `quick`, write the table that `--accuracy` reads."""
    notify = notify or Progress().message
    cases = CASES[:2] if quick else CASES
    finest = (_QUICK_REFERENCE if quick else _REFERENCE)[1]
    force = []
    estimated = []
    distances = []
    for case in cases:
        notify(f"levels: a ball of {1e3 * case.radius:g} mm")
        true = press(finest, case)
        own = _press(case)
        force.append(own.force - true.force)
        estimated.append(_estimated(own.force) - true.force)
        distances.append(np.linalg.norm(own.p_SM - true.p_SM, axis=1))
    notify("levels: an egg held")
    held = _held()
    rows = [
        _row(QUASISTATIC, held["force_noise_N"], force, _rms(distances), held["quasistatic_ms"]),
        _row(SAMPLED, 0.0, estimated, math.nan, held["quasistatic_ms"] + held["sampling_ms"]),
    ]
    count = (PAIRS_QUICK if quick else PAIRS) if pairs is None else pairs
    ended = [_outcomes(FIRST_SEED + k, k, count, notify) for k in range(count)]
    for row in rows:
        row["outcomes"] = count
        row["same_outcomes"] = sum(run_row[row["effects"]] == run_row["auto"] for run_row in ended)
    result = {"stamp": stamp(), "rows": rows, "ended": ended}
    if not quick:
        write_json(levels_path(), {"stamp": result["stamp"], "rows": rows})
    write_json(out / "levels.json", result)
    return result


def _row(
    effects: str, noise: float, errors: list[Any], surface: float, cost: float
) -> dict[str, Any]:
    bias = _rms(errors)
    return {
        "effects": effects,
        "mesh": list(QS_GRID),
        "timestep_ms": 1e3 * STEP,
        "tolerance": Setting().tolerance,
        "force_error_N": math.hypot(bias, noise),
        "surface_error_um": None if math.isnan(surface) else 1e6 * surface,
        "force_noise_N": noise,
        "ms_per_s": cost,
    }


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(np.concatenate([np.ravel(value) for value in values])))))


def _press(case: Case) -> Pressed:
    """Run `benchmarks.simulation_cases.press` with a quasi-static membrane."""
    world = PressWorld(
        SENSOR,
        Indenter("sphere", case.radius),
        at=case.at,
        timestep=STEP,
        mesh=QS_GRID,
        effects=_WITHOUT,
    )
    world.inflate(1000.0, seal=True)
    world.press(case.depth)
    world.step(20)
    force = -ground_truth.contact_force(world, 0)[2]
    return Pressed(float(force), world.marker_poses(0)[0], 0.0)


def _estimated(force: float) -> np.ndarray:
    """Return synthetic estimates (n,), N, of this normal force, one per simulated grasp."""
    errors = load_errors(load_sensor(SENSOR))
    here = errors.at(force)
    rng = np.random.default_rng(0)
    return (
        force * (1 + errors.gain[2, 2]) - here.mean[2] + here.sd[2] * rng.standard_normal(_SAMPLES)
    )


def _held() -> dict[str, float]:
    """Measure cost and force noise while two quasi-static membranes hold an egg.

    Costs are in ms of one core per simulated second: of the simulation, and of sampling the
    touches.
    """
    world = hold(GraspWorld(SENSOR, "egg", timestep=STEP, opening=0.05, effects=_WITHOUT))
    frame = 16  # steps at 30 Hz
    quasistatic = core_ms(lambda: world.step(frame), 20) / frame / STEP
    design = load_sensor(SENSOR)
    sources = [
        SyntheticTouchSource(sensor, load_errors(design), design.membrane.friction, k)
        for k, sensor in enumerate(world.sensors)
    ]
    sampling = core_ms(lambda: [source.capture() for source in sources], 50) * design.camera.rate
    forces = []
    for _ in range(round(0.2 / STEP)):
        world.step()
        forces.append([ground_truth.contact_force(world, i)[2] for i in range(len(world.sensors))])
    noise = float(np.std(forces, axis=0).mean())
    return {"quasistatic_ms": quasistatic, "sampling_ms": sampling, "force_noise_N": noise}


def _outcomes(seed: int, number: int, count: int, notify: Notify) -> dict[str, str]:
    ended = {}
    for effects in ("auto", QUASISTATIC, SAMPLED):
        notify(f"levels: episode {number + 1} of {count}, {effects}")
        scenario = Scenario(
            object=f"random:{seed}",
            controller="gentle",
            seed=seed,
            effects=effects,
            randomization="default",
        )
        ended[effects] = run_episode(Episode(number, scenario))["outcome"]
    return ended


def table(result: dict[str, Any]) -> str:
    """Format the rows as a Markdown table."""
    names = {QUASISTATIC: "quasi-static membrane", SAMPLED: "quasi-static membrane, sampled touch"}
    made = result["stamp"]
    lines = [
        f"Measured on {made['machine']}, MuJoCo {made['mujoco']}, {made['date']}.",
        "",
        "| level | `effects` | step ms | force error mN | surface error um | noise mN "
        "| ms per simulated s | same outcome |",
        "|---" * 8 + "|",
    ]
    for row in result["rows"]:
        surface = row["surface_error_um"]
        lines.append(
            f"| {names[row['effects']]} | `{row['effects']}` | {row['timestep_ms']:.2f} "
            f"| {1e3 * row['force_error_N']:.1f} | {'' if surface is None else f'{surface:.0f}'} "
            f"| {1e3 * row['force_noise_N']:.1f} | {row['ms_per_s']:.0f} "
            f"| {_fraction(row)} |"
        )
    return "\n".join(lines) + "\n"


def _fraction(row: dict[str, Any]) -> str:
    """Format the fraction of episodes with the same outcome; "" where none was run."""
    return f"{row['same_outcomes']} of {row['outcomes']}" if row["outcomes"] else ""
