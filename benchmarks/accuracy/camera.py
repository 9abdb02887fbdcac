"""Camera part of `bench accuracy`: errors of the shipped sensors against simulated ground truth.

The sweeps vary resolution, frame rate, markers and rendered effects. The world is loaded once per
set of markers. Every camera then views the same states.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.simulation_cases import SENSOR, attempt
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.sensor_parts import CameraDesign, MarkerLayout
from mjtactile.core.types import Array
from mjtactile.sensing.stateful_pipeline import StatefulPipeline
from mjtactile.sim import ground_truth
from mjtactile.sim.rendering.renderer import Effects, Renderer
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

_DEPTHS = (1.0e-3, 2.5e-3)
_FRAMES = 6
_SPEED = 0.02  # speed of the load for the rate sweep, m/s
RESOLUTIONS = (0.4, 0.6, 0.8, 1.0, 1.5, 2.0)
RATES = (15.0, 30.0, 60.0, 120.0)
MARKERS = {
    "4x4": (4, 4, 1.5e-3),
    "6x6": (6, 6, 1.3e-3),
    "9x9": (9, 9, 1.0e-3),
    "11x11": (11, 11, 0.8e-3),
}
SENSORS = ("paper16", "dense", "fine")
SAMPLED = {
    "as designed": Effects(),
    "no noise": Effects(noise_dn=0.0),
    "noise x 3": Effects(noise_dn=6.0),
    "no blur": Effects(blur_px=0.0),
    "blur x 3": Effects(blur_px=2.1),
}


@dataclass(frozen=True, eq=False)
class State:
    """Appearance of one state: marker poses in frame S, and the true normal force, N."""

    p_SM: Array
    n_S: Array
    force: float


def run(quick: bool, notify: Callable[[str], None]) -> dict[str, Any]:
    """Measure force error, marker error and processing time for each row of each sweep.

    Force errors are rms values in N, marker errors rms values in um. The times of rendering and of
    perception are in ms per image.
    """
    design = load_sensor(SENSOR)
    states = _states(design)

    def row(
        name: str,
        rendered: SensorDesign,
        moments: list[State],
        effects: Effects = SAMPLED["as designed"],
    ) -> dict[str, Any]:
        result = {"name": name} | attempt(lambda: _evaluate(rendered, moments, effects))
        notify(f"camera, {name}: {result.get('failed') or result['force_error_N']}")
        return result

    scales = (0.6, 1.0) if quick else RESOLUTIONS
    markers = {k: v for k, v in MARKERS.items() if not quick or k == "9x9"}
    sensors = SENSORS[1:] if quick else SENSORS
    return {
        "sensors": [row(name, (one := load_sensor(name)), _states(one)) for name in sensors],
        "resolution": [
            row(
                f"{round(640 * s)}x{round(480 * s)}",
                replace(design, camera=_scaled(design.camera, s)),
                states,
            )
            for s in scales
        ],
        "markers": [
            row(name, (other := _with_markers(design, *layout)), _states(other))
            for name, layout in markers.items()
        ],
        "renderer": [
            row(name, design, states, effects)
            for name, effects in list(SAMPLED.items())[: 2 if quick else None]
        ],
        "rate": _rates(design),
    }


def _scaled(camera: CameraDesign, s: float) -> CameraDesign:
    """Return the camera with `s` times the pixels per side and the same view.

    The lens blur scales with the pixels; the noise per pixel stays.
    """
    return replace(
        camera,
        width=round(camera.width * s),
        height=round(camera.height * s),
        fx=camera.fx * s,
        fy=camera.fy * s,
        cx=(camera.cx + 0.5) * s - 0.5,
        cy=(camera.cy + 0.5) * s - 0.5,
        blur_px=camera.blur_px * s,
    )


def _with_markers(design: SensorDesign, rows: int, columns: int, radius: float) -> SensorDesign:
    extent_x = 32e-3
    extent_y = 24e-3
    return replace(
        design,
        markers=MarkerLayout(
            rows, columns, extent_x / (columns - 1), extent_y / (rows - 1), radius
        ),
    )


def _states(design: SensorDesign) -> list[State]:
    """Simulate the flat, the inflated and the indented membrane.

    A 16 mm sphere is pressed to each depth.
    """
    world = PressWorld(design, Indenter("sphere", 16e-3), at=(0.7e-3, 0.4e-3))
    states = []
    for pressure in (0.0, 1000.0):
        world.inflate(pressure, seal=pressure > 0)
        states.append(_state(world))
    for depth in _DEPTHS:
        world.press(depth)
        states.append(_state(world))
    return states


def _state(world: PressWorld) -> State:
    return State(*world.marker_poses(0), float(-ground_truth.contact_force(world, 0)[2]))


def _evaluate(design: SensorDesign, states: list[State], effects: Effects) -> dict[str, Any]:
    renderer = Renderer(design, seed=1)
    perception = StatefulPipeline.of(design, contact_shapes=False)
    flat, rest, *pressed = states
    perception.measure_flat_reference(
        [renderer.render(flat.p_SM, flat.n_S, effects=effects) for _ in range(_FRAMES)]
    )
    perception.measure_rest_reference(
        [renderer.render(rest.p_SM, rest.n_S, effects=effects) for _ in range(_FRAMES)], 1000.0
    )
    errors = []
    distances = []
    spent = np.zeros(2)
    for state in pressed:
        for _ in range(_FRAMES):
            start = time.thread_time()
            image = renderer.render(state.p_SM, state.n_S, effects=effects)
            rendered = time.thread_time()
            touch = perception.perceive(image, 0.0)
            spent += (rendered - start, time.thread_time() - rendered)
            errors.append(touch.force_normal - state.force)
            if touch.markers is not None:
                distances.append(
                    np.linalg.norm(touch.markers.p_SM - state.p_SM[touch.markers.ids], axis=1)
                )
    count = len(errors)
    return {
        "force_error_N": float(np.sqrt(np.mean(np.square(errors)))),
        "marker_error_um": 1e6 * float(np.sqrt(np.mean(np.square(np.concatenate(distances)))))
        if distances
        else float("nan"),
        "unknown": int(np.count_nonzero(~np.isfinite(errors))),
        "camera_ms": 1e3 * spent[0] / count,
        "perception_ms": 1e3 * spent[1] / count,
    }


def _rates(design: SensorDesign) -> list[dict[str, Any]]:
    """Return the sample-and-hold error of a perfect force sensor at each frame rate.

    A 16 mm sphere is pressed in at 20 mm/s. The last reading is held until the next image.
    """
    world = PressWorld(design, Indenter("sphere", 16e-3), timestep=1e-3)
    world.inflate(1000.0, seal=True)
    forces: list[float] = []
    world.after_each_step(lambda: forces.append(float(-ground_truth.contact_force(world, 0)[2])))
    world.press(2.5e-3, speed=_SPEED)
    trace = np.array(forces)[: round(4.5e-3 / _SPEED / 1e-3)]  # clearance and depth
    rows = []
    for rate in RATES:
        hold = (np.arange(len(trace)) // max(1, round(1e3 / rate))) * max(1, round(1e3 / rate))
        error = float(np.sqrt(np.mean((trace[hold] - trace) ** 2)))
        rows.append({"name": f"{rate:g} Hz", "rate_Hz": rate, "force_error_N": error})
    return rows


def table(result: dict[str, Any]) -> str:
    """Format the result as a Markdown table."""
    lines = [
        "| camera | force error mN | marker error um | camera ms | perception ms |",
        "|---|---|---|---|---|",
    ]
    for sweep in ("sensors", "resolution", "markers", "renderer"):
        lines += [
            f"| {sweep}: {r['name']} | failed: {r['failed']} | | | |"
            if "failed" in r
            else f"| {sweep}: {r['name']} | {1e3 * r['force_error_N']:.1f} | "
            f"{r['marker_error_um']:.1f} | {r['camera_ms']:.1f} | "
            f"{r['perception_ms']:.1f} |"
            for r in result[sweep]
        ]
    rates = ", ".join(f"{1e3 * r['force_error_N']:.1f} at {r['name']}" for r in result["rate"])
    lines += [
        "",
        "Error of an exact value until the next image, sphere pressed at "
        f"{1e3 * _SPEED:.0f} mm/s, mN: {rates}.",
    ]
    return "\n".join(lines) + "\n"
