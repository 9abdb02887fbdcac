"""Simulated sensor on a stand, its camera and sensing pipeline (`View`), and a drive with a load
cell (`TestBench`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.flags import Flags, merge_flags
from mjtactile.core.types import Image, PressureReading, Touch
from mjtactile.runtime.uncertain_force_monitor import UncertainForceMonitor
from mjtactile.sensing.settings import DEFAULTS
from mjtactile.sensing.stateful_pipeline import StatefulPipeline
from mjtactile.sensing.touch.squeeze import contact_face
from mjtactile.sim import ground_truth
from mjtactile.sim.rendering.renderer import Renderer
from mjtactile.sim.scenes.indentation import Indenter, PressWorld
from mjtactile.sim.sensor.mesh_sensor import TactileSensor

_REFERENCE_IMAGES = 10
_GAUGE_SD = 5.0  # noise of the pressure sensor, Pa, as of a rig without a calibration


class View:
    """Camera, pressure sensor and pipeline of the sensor in `world`, assuming `design`. For
    `contact_shapes` see `StatefulPipeline`."""

    def __init__(
        self,
        world: PressWorld,
        design: SensorDesign,
        *,
        seed: int = 0,
        shadows: bool = False,
        gauge: bool = False,
        contact_shapes: bool | None = False,
    ):
        self.world = world
        self.sealed = True
        self._noise = np.random.default_rng([seed, 1]) if gauge else None
        self.renderer = Renderer(design, seed=seed, shadows=shadows)
        sensor = world.sensors[0]
        settings = DEFAULTS
        if isinstance(sensor, TactileSensor):
            settings = DEFAULTS.for_mesh(design, (sensor.mesh.nx, sensor.mesh.ny))
        self.perception = StatefulPipeline.of(
            design, settings=settings, contact_shapes=contact_shapes
        )
        self._uncertain = UncertainForceMonitor(["sensor"], lasts=0.0)  # the loads are settled

    @property
    def flags(self) -> Flags:
        """Reasons for reduced accuracy of the world and of the estimates."""
        return merge_flags((self.world.flags, self._uncertain.flags))

    def image(self) -> Image:
        """Return the current camera image."""
        return self.renderer.render(*self.world.marker_poses(0), self.world.time)

    def images(self) -> list[Image]:
        """Return the images of one reference."""
        return [self.image() for _ in range(_REFERENCE_IMAGES)]

    def touch(self) -> Touch:
        """Return the touch estimated from one image."""
        return self.perception.perceive(self.image(), self.world.time, self._reading())

    def settled_touch(self) -> Touch:
        """Return the touch of a second image. The covariance of the first includes a sudden load
        change."""
        self.touch()
        touch = self.touch()
        self._uncertain.on_touches(self.world.time, [touch])
        return touch

    def _reading(self) -> PressureReading | None:
        """Return a reading of the pressure sensor; None without one."""
        if self._noise is None:
            return None
        pressure = self.world.sensors[0].gauge_pressure + _GAUGE_SD * self._noise.normal()
        return PressureReading(pressure, _GAUGE_SD, self.world.time, not self.sealed)


def take_references(
    world: PressWorld, views: Sequence[View], gauge_pressure: float, *, sealed: bool = True
) -> None:
    """Take the flat reference (valve open to the air) and the inflated reference.

    The membrane is inflated to `gauge_pressure` Pa and settled, sealed or not. A session does the
    same with a rig; this world has no clock to wait for.
    """
    world.inflate(0.0, seal=False)
    for view in views:
        view.perception.measure_flat_reference(view.images())
    world.inflate(gauge_pressure, seal=sealed)
    for view in views:
        view.sealed = sealed
        view.perception.measure_rest_reference(view.images(), gauge_pressure, sealed=sealed)


class TestBench:
    """One indentation experiment. `placing` goes to `PressWorld` (at, tilt, mesh)."""

    def __init__(self, design: SensorDesign, indenter: Indenter, *, seed: int = 0, **placing: Any):
        self.design = design
        self.world = PressWorld(design, indenter, **placing)
        self._view = View(self.world, design, seed=seed)
        self._rest_height = 0.0

    def zero(self, *, sealed: bool = True) -> None:
        """Take both references: flat and vented, then inflated to the supply."""
        take_references(self.world, [self._view], self.design.chamber.supply_gauge, sealed=sealed)
        surface = self.touch().surface
        self._rest_height = float(surface.z.max()) if surface is not None else 0.0

    def image(self) -> Image:
        """Return the current camera image."""
        return self._view.image()

    def touch(self) -> Touch:
        """Return the touch estimated from one image."""
        return self._view.touch()

    def load_cell(self) -> float:
        """Return the normal force, N, of a load cell behind the indenter, also in motion."""
        return -float(ground_truth.contact_force(self.world, 0)[2])

    def measure(self, images: int = 1) -> dict[str, float]:
        """Return means over some images: normal force, membrane area and indentation.

        The area is that of the whole membrane. The indentation is NaN if no contact is detected.
        """
        touches = [self.touch() for _ in range(images)]
        heights = [face[0] for touch in touches if (face := contact_face(touch)) is not None]
        areas = [touch.surface.area for touch in touches if touch.surface is not None]
        indentation = self._rest_height - float(np.mean(heights)) if heights else math.nan
        return {
            "force_N": float(np.mean([t.force_normal for t in touches])),
            "membrane_area_mm2": 1e6 * float(np.mean(areas)),
            "indentation_mm": 1e3 * indentation,
        }
