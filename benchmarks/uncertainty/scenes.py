"""Random scenes of `mjtactile bench uncertainty`: sensor, indenter, position and motion of each
seed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.scenes.stress_scenes import FreeObject
from mjtactile.core import resources
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.sim.scenes.indentation import Indenter

KINDS = ("press", "edge", "press", "tap", "hold", "press", "edge", "rhythm", "press", "shaken")
"""Kinds of scenes, in turn: loads and drags anywhere or near the frame, taps, an object between two
sensors, a load that oscillates several times a second, a load on a rotated and shaken sensor."""
SENSORS = ("dense", "paper16", "dense at half resolution", "paper16 at half resolution")
FINE = ("fine", "fine at half resolution")
FINE_FROM = 1200
"""Seeds from here on use `FINE` in turn; earlier scenes stay those of tables before `fine`
existed."""
MESHES = ((13, 11), (13, 11), (17, 13), (21, 17))
SIZES = {"sphere": (3e-3, 16e-3), "cylinder": (2.5e-3, 8e-3), "box": (5e-3, 14e-3)}
MODELS = ("wedge", "corner", "spheres")
_HELD_SIZES = {"sphere": (6e-3, 16e-3), "box": (8e-3, 16e-3), "rod": (3e-3, 10e-3)}
# minimum distance of an indenter from the frame, m; contact with the frame is not a touch of the
# membrane
_MARGIN = 1.5e-3


@dataclass(frozen=True)
class Scene:
    """One scene.

    Chamber pressure `supply`, Pa. An `indenter` at `at`, m, with `tilt`, rad, or a held `body`. It
    applies the `forces`, N, one after the other at `speed`, m/s, and is dragged by `shear`, m. Taps
    reach `depth`, m; oscillations reach it at `frequency`, Hz. The sensor is rotated by `mount`,
    rad, and shaken by `shake` (amplitude, m, and frequency, Hz).
    """

    seed: int
    kind: str
    sensor: str
    mesh: tuple[int, int]
    supply: float
    indenter: Indenter
    body: FreeObject
    at: tuple[float, float]
    tilt: float
    forces: tuple[float, float]
    speed: float
    shear: float
    depth: float
    frequency: float
    mount: tuple[float, float, float]
    shake: tuple[float, float]

    @property
    def design(self) -> SensorDesign:
        """Design of the sensor, with its supply."""
        name, _, coarse = self.sensor.partition(" ")
        design = load_sensor(name)
        camera = design.camera
        c = 0.5
        if coarse:  # the same lens before half as many pixels a side; its blur is the lens's
            camera = replace(
                camera,
                width=camera.width // 2,
                height=camera.height // 2,
                fx=c * camera.fx,
                fy=c * camera.fy,
                cx=c * (camera.cx + 0.5) - 0.5,
                cy=c * (camera.cy + 0.5) - 0.5,
                blur_px=c * camera.blur_px,
            )
        return replace(
            design, camera=camera, chamber=replace(design.chamber, supply_gauge=self.supply)
        )

    @property
    def shape(self) -> str:
        """Name of the object in contact."""
        if self.kind == "hold":
            return self.body.kind
        return self.indenter.path.stem if self.indenter.path else self.indenter.kind


def sample_scene(seed: int) -> Scene:
    """Sample the scene of a seed.

    Kinds and sensors alternate; all else is random.
    """
    rng = np.random.default_rng([seed, 23])
    kind = KINDS[seed % len(KINDS)]
    sensors = FINE if seed >= FINE_FROM else SENSORS
    sensor = sensors[seed // len(KINDS) % len(sensors)]
    indenter = _indenter(rng)
    half = np.array([20e-3, 15e-3]) - _MARGIN - _extent(indenter)
    at = rng.uniform(-0.6, 0.6, 2) * half
    if kind == "edge":  # next to one of the four sides, as near as the indenter fits
        side = int(rng.integers(2))
        at[side] = float(rng.choice([-1, 1])) * half[side] * rng.uniform(0.85, 1.0)
    kind_held = list(_HELD_SIZES)[rng.integers(len(_HELD_SIZES))]
    forces = np.sort(np.exp(rng.uniform(np.log(0.04), np.log(1.8), 2)))
    frequency = float(rng.uniform(2, 10))
    turned = rng.normal(size=3)
    turned *= np.pi * rng.uniform() / np.linalg.norm(turned)
    shaken = kind == "shaken"
    return Scene(
        seed,
        kind,
        sensor,
        mesh=MESHES[rng.integers(len(MESHES))],
        supply=float(rng.uniform(600, 2000)),
        indenter=indenter,
        body=FreeObject(
            kind_held, float(rng.uniform(*_HELD_SIZES[kind_held])), float(rng.uniform(5e-3, 30e-3))
        ),
        at=(float(at[0]), float(at[1])),
        tilt=float(rng.uniform(-0.15, 0.15)),
        forces=(float(forces[0]), float(forces[1])),
        speed=float(np.exp(rng.uniform(np.log(0.05), np.log(0.5))))
        if kind == "tap"
        else float(rng.uniform(5e-3, 30e-3)),
        shear=float(rng.uniform(-1e-3, 1e-3)),
        depth=float(rng.uniform(0.5e-3, 3e-3)),
        frequency=frequency,
        mount=(float(turned[0]), float(turned[1]), float(turned[2])) if shaken else (0.0, 0.0, 0.0),
        shake=(float(rng.uniform(0.2, 1.0) * 9.81 / (2 * np.pi * frequency) ** 2), frequency)
        if shaken
        else (0.0, 0.0),
    )


def _indenter(rng: np.random.Generator) -> Indenter:
    """Sample an indenter.

    One in eight is a sharp or double model. The others are spheres, cylinders and boxes.
    """
    if rng.uniform() < 1 / 8:
        return Indenter(
            "model",
            path=resources.folder("models/reference_cases")
            / f"{MODELS[rng.integers(len(MODELS))]}.xml",
        )
    kind = list(SIZES)[rng.integers(len(SIZES))]
    return Indenter(kind, float(rng.uniform(*SIZES[kind])))


def _extent(indenter: Indenter) -> float:
    """Return the lateral half-extent of the possible contact, m."""
    sizes = {
        "sphere": min(indenter.size, 7e-3),
        "cylinder": indenter.size,
        "box": indenter.size / np.sqrt(2),
    }
    return sizes.get(indenter.kind, 10e-3)
