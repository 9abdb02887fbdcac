"""`mjtactile bench touch`: force, shear, torque, patch, smallest touch and standard deviations.

Random indenters load one simulated membrane. Three cameras with different marker layouts
(`SENSORS`) view it; all else is common. Nothing is calibrated for an object. Ground truth is the
simulation on a mesh finer than the default, since a coarse mesh is stiffer than rubber. The true
contact area is that of a quasi-static membrane on the object, the centroid that of the forces.
Edges, corners and two balls together have separate rows, without and with the estimated shape
(`sharp_indenters`). It takes about five minutes of a processor. Seeds below FIRST_SEED were used in
tuning and are excluded.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.paper.deformation import MembraneModel
from benchmarks.paper.force_methods import MembraneForce, spring_grid_force
from benchmarks.shape.random_indenters import Case
from benchmarks.touch import sharp_indenters
from benchmarks.touch.area_force_constant import calibrate_area
from benchmarks.touch.tables import plot, summary, table
from mjtactile.calibrate.force import AreaCalibration
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.types import Array, Image, Touch
from mjtactile.experiments.test_bench import View, take_references
from mjtactile.sim import ground_truth
from mjtactile.sim.rendering.renderer import Renderer
from mjtactile.sim.scenes.indentation import Indenter, PressWorld
from mjtactile.sim.sensor.mesh import MarkerInterpolator

__all__ = ["run", "table"]
SENSORS = ("dense", "paper16", "fine")
MESH = (33, 25)
MESH_QUICK = (21, 16)
FIRST_SEED = 1000
EPISODES = 20
QUIET_FRAMES = 900
_REFERENCE_IMAGES = 10
_PERIOD = 1 / 30
_SIZES = {"sphere": (3e-3, 12e-3), "cylinder": (2.5e-3, 6e-3), "box": (5e-3, 11e-3)}
_FORCE_MAX = 2.5  # maximum force, N
_OFF_NOMINAL_FRAMES = 20
_FRAMES = 3  # images of each state; the last one counts

Notify = Callable[[str], None]


class LayoutView(View):
    """Camera and perception of one marker layout over a world that was built for another."""

    def __init__(self, design: SensorDesign, world: PressWorld, seed: int):
        super().__init__(world, design, seed=seed)
        self.design = design
        self._markers = MarkerInterpolator(world.sensors[0].mesh, design.markers.p_SM)
        self._model = MembraneModel(design)
        self._weak = MembraneForce(self._model)
        self._weak_rest: Any = None
        self._clock = 0.0
        self.milliseconds: list[float] = []

    def image(self) -> Image:
        self._clock += _PERIOD
        return self.renderer.render(
            *self._markers.marker_poses(self.world.sensors[0].p_SV), self._clock
        )

    def measure_rest_reference(self, pressure: float) -> None:
        """Measure the rest state of the weak form, the baseline of the other levels."""
        sensing = self.perception.pipeline
        state = self.perception.state
        self._weak_rest = self._weak.rest_state(
            sensing.detect_rest_markers(state, self.images()), pressure
        )

    def estimate(self, image: Image | None = None) -> Touch:
        image = self.image() if image is None else image
        touch = self.perception.perceive(image, image.time)
        # repeat from the surface on: time on one core
        if touch.surface is not None and touch.markers is not None:
            start = time.thread_time()
            sensing = self.perception.pipeline
            state = self.perception.state
            _, self.perception.state = sensing.estimate_touch(
                state, touch.markers, touch.surface, image.time + 1e-4
            )
            self.milliseconds.append(1e3 * (time.thread_time() - start))
        return touch

    def other_levels(self, touch: Touch, calibration: AreaCalibration) -> dict[str, Any]:
        """Estimate the normal force, N, by the paper's levels 1 and 2 and by the weak form.

        The weak form uses interpolated markers.
        """
        reference = self.perception.state.reference
        surface = touch.surface
        markers = touch.markers
        assert reference is not None and surface is not None and markers is not None
        springs = spring_grid_force(surface, reference.surface, self.design.membrane.pretension)
        weak = self._weak.wrench(markers.ids, markers.p_SM, self._weak_rest)[0]
        return {
            "level1_N": calibration.force(surface.area - reference.surface.area),
            "level2_N": -float(springs[..., 2].sum()),
            "weak_form_N": -float(weak[2]),
        }


def run(out: Path, *, quick: bool = False, notify: Notify = lambda _: None) -> dict[str, Any]:
    """Press, drag and hold; return one row for each image of each sensor."""
    mesh = MESH_QUICK if quick else MESH
    calibrations = {name: calibrate_area(load_sensor(name)) for name in SENSORS}
    rows = []
    milliseconds = {name: [] for name in SENSORS}
    for seed in range(FIRST_SEED, FIRST_SEED + (3 if quick else EPISODES)):
        rows += _episode(seed, mesh, calibrations, milliseconds)
        notify(
            f"press {seed}: "
            + ", ".join(
                f"{r['force_true_N'][2]:.2f} N ({r['sensor']} {r['error_N'][2]:+.3f})"
                for r in rows[-4:]
            )
        )
    edges: list[dict[str, Any]] = []
    for seed, case in sharp_indenters.indenters(quick=quick):
        edges += _sharp_episode(seed, case, mesh)
        notify(
            f"{case.name} {seed}: " + ", ".join(f"{r['error_shape_N']:+.3f}" for r in edges[-3:])
        )
    quiet = _quiet(60 if quick else QUIET_FRAMES)
    result: dict[str, Any] = {
        "mesh": mesh,
        "touches": rows,
        "sharp": edges,
        "quiet": quiet,
        "off_nominal": _off_nominal(),
    }
    result["milliseconds"] = {name: float(np.median(ms)) for name, ms in milliseconds.items()}
    result["milliseconds_p95"] = {
        name: float(np.percentile(ms, 95)) for name, ms in milliseconds.items()
    }
    result["sensors"] = {name: summary(name, result) for name in SENSORS}
    result["sharp_sensors"] = {name: sharp_indenters.summary(name, edges) for name in SENSORS}
    plot(rows, out / "touch.png")
    return result


def _start(
    indenter: Indenter,
    at: tuple[float, float],
    tilt: float,
    mesh: tuple[int, int],
    seed: int,
    names: tuple[str, ...] = SENSORS,
) -> tuple[PressWorld, dict[str, LayoutView]]:
    """Build an inflated, sealed sensor, its cameras with references, and a waiting indenter."""
    world = PressWorld("dense", indenter, at=at, tilt=tilt, mesh=mesh)
    views = {name: LayoutView(load_sensor(name), world, seed) for name in names}
    supply = world.design.chamber.supply_gauge
    take_references(world, list(views.values()), supply)
    for view in views.values():
        view.measure_rest_reference(supply)
    return world, views


def random_indenter(rng: np.random.Generator, seed: int) -> Indenter:
    """Sample an indenter's size; kinds alternate with the seed."""
    kind = list(_SIZES)[seed % len(_SIZES)]
    smallest, largest = _SIZES[kind]
    return Indenter(kind, rng.uniform(smallest, largest))


def _episode(
    seed: int,
    mesh: tuple[int, int],
    calibrations: Mapping[str, AreaCalibration],
    milliseconds: dict[str, list[float]],
) -> list[dict[str, Any]]:
    """Apply a light touch, two loads and a drag along x with one random indenter."""
    rng = np.random.default_rng([seed, 5])
    indenter = random_indenter(rng, seed)
    world, views = _start(
        indenter,
        (rng.uniform(-8e-3, 8e-3), rng.uniform(-5.5e-3, 5.5e-3)),
        rng.uniform(-0.1, 0.1),
        mesh,
        seed,
    )
    rows = []
    depths = [rng.uniform(0.15e-3, 0.4e-3), rng.uniform(0.5e-3, 2e-3), rng.uniform(2e-3, 6e-3)]
    for stage, shear in ((0, 0.0), (1, 0.0), (2, 0.0), (2, rng.uniform(-1e-3, 1e-3))):
        depth = depths[stage]
        world.press(depth, shear)
        while -ground_truth.contact_force(world, 0)[2] > _FORCE_MAX:
            depth *= 0.8
            world.press(depth, shear)
        depths[stage] = depth
        for name, view in views.items():
            touches = [view.estimate() for _ in range(_FRAMES)]
            rows.append(
                {
                    "sensor": name,
                    "seed": seed,
                    "kind": indenter.kind,
                    **_compare(world, touches[-1]),
                    **view.other_levels(touches[-1], calibrations[name]),
                }
            )
    for name, view in views.items():
        milliseconds[name] += view.milliseconds
    return rows


def _sharp_episode(seed: int, case: Case, mesh: tuple[int, int]) -> list[dict[str, Any]]:
    with tempfile.TemporaryDirectory() as folder:
        body = Indenter("model", path=case.write(Path(folder)))
        world, views = _start(body, case.at, 0.0, mesh, seed)
    return sharp_indenters.episode(seed, case, world, views)


def _compare(world: PressWorld, touch: Touch) -> dict[str, Any]:
    """Return the estimate and the ground truth of one image."""
    forces, points, _ = ground_truth.contact_forces(world, 0)
    wrench_true = np.r_[forces.sum(axis=0), np.cross(points, forces).sum(axis=0)]
    assert touch.traction is not None and touch.contact is not None
    wrench = touch.traction.wrench
    cov = touch.traction.wrench_cov
    centroid = -forces[:, 2] @ points[:, :2] / max(-wrench_true[2], 1e-9)
    return {
        "force_true_N": wrench_true[:3],
        "force_N": wrench[:3],
        "error_N": (wrench - wrench_true)[:3],
        "torque_error_Nmm": 1e3 * (wrench - wrench_true)[3:],
        "sd": np.sqrt(np.diag(cov)),
        "direction_error_deg": _angle(wrench[:3], wrench_true[:3]),
        "touching": touch.touching,
        "patches": len(touch.patches),
        "area_true_mm2": 1e6 * ground_truth.contact_area(world, 0),
        "area_mm2": 1e6 * touch.contact.area,
        "penetration_mm": 1e3 * ground_truth.penetration(world, 0),
        "centroid_error_mm": 1e3 * float(np.linalg.norm(touch.contact.centroid - centroid)),
        "pressure_error_Pa": touch.traction.gauge_pressure - world.sensors[0].gauge_pressure,
    }


def _angle(a: Array, b: Array) -> float:
    cosine = a @ b / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-12)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _quiet(frames: int) -> dict[str, Any]:
    """Count false alarms and measure the force noise without contact, over `frames` images."""
    _, views = _start(Indenter("sphere", 5e-3), (0.0, 0.0), 0.0, MESH_QUICK, 99)
    result = {}
    for name, view in views.items():
        touches = [
            view.perception.perceive(image, image.time)
            for image in (view.image() for _ in range(frames))
        ]
        force = np.array([t.force_normal for t in touches])
        result[name] = {
            "frames": frames,
            "false_alarms": sum(t.touching for t in touches),
            "mean_N": float(force.mean()),
            "sd_N": float(force.std()),
            "largest_N": float(force.max()),
            "predicted_sd_N": float(np.mean([t.force_normal_sd for t in touches])),
        }
    return result


def _off_nominal(mesh: tuple[int, int] = MESH_QUICK) -> list[dict[str, Any]]:
    """Load once with a single deviation from the sensor file; return force shift and standard
    deviation."""
    rows = []
    for name in SENSORS:
        nominal = load_sensor(name)
        camera = replace(
            nominal, camera=replace(nominal.camera, distance=nominal.camera.distance + 1e-4)
        )
        stiff = replace(
            nominal, membrane=replace(nominal.membrane, young=1.1 * nominal.membrane.young)
        )
        for case, in_world in (
            ("nominal", nominal),
            ("modulus +10 %", stiff),
            ("gas +3 K after the references", nominal),
            ("camera displaced by 0.1 mm after the references", nominal),
            ("20 % of the markers missing", nominal),
        ):
            world = PressWorld(in_world, Indenter("sphere", 8e-3), at=(3e-3, 2e-3), mesh=mesh)
            view = LayoutView(nominal, world, 7)
            take_references(world, [view], nominal.chamber.supply_gauge)
            world.press(3e-3)
            gone = np.random.default_rng(3).permutation(nominal.markers.count)[
                : nominal.markers.count // 5
            ]
            p, n = MarkerInterpolator(world.sensors[0].mesh, nominal.markers.p_SM).marker_poses(
                world.sensors[0].p_SV
            )
            keep = (
                np.setdiff1d(np.arange(len(p)), gone)
                if case.startswith("20")
                else np.arange(len(p))
            )
            renderer = Renderer(camera if case.startswith("camera") else nominal, seed=8)
            state = view.perception.state
            reference = state.reference
            if (
                case.startswith("gas")
                and reference is not None
                and reference.rest.gas.constant is not None
            ):
                # a chamber 3 K warmer holds (1 + 3/T) of the p V assumed by the sensor
                gas = replace(
                    reference.rest.gas,
                    constant=reference.rest.gas.constant / (1 + 3 / nominal.chamber.temperature),
                )
                view.perception.state = replace(
                    state, reference=replace(reference, rest=replace(reference.rest, gas=gas))
                )
            images = (
                renderer.render(p[keep], n[keep], 10.0 + k * _PERIOD)
                for k in range(_OFF_NOMINAL_FRAMES)
            )
            touch = [view.estimate(image) for image in images][-1]
            assert touch.traction is not None
            rows.append(
                {
                    "sensor": name,
                    "case": case,
                    "force_true_N": -float(ground_truth.contact_force(world, 0)[2]),
                    "force_N": -float(touch.traction.wrench[2]),
                    "status": touch.status,
                    "sd_N": float(np.sqrt(touch.traction.wrench_cov[2, 2])),
                }
            )
    return rows
