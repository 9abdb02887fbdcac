"""Simulated stage: an object in a holder, rotated and lowered onto one upward-facing sensor.

The area covered by the holder is touched after the object was turned upside down. Its position in
the holder then changes slightly; the exploration does not have this offset.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.flags import Flags, merge_flags
from mjtactile.core.types import Array, Touch
from mjtactile.experiments.test_bench import View, take_references
from mjtactile.explore.next_best_touch import Aim
from mjtactile.explore.patch_from_touch import Pressed
from mjtactile.runtime.uncertain_force_monitor import UncertainForceMonitor
from mjtactile.sim.scenes.objects import ObjectModel
from mjtactile.sim.scenes.stage import ObjectOnStage, ObjectOnStageWorld

MESH = (25, 21)
"""Mesh on which the simulated membrane has the shape of rubber; `mjtactile press` warns for a
coarser mesh."""
_STEP = 2.5e-4  # lowering step of the stage between images, m
_TRAVEL = 2.6e-3  # maximum depth below first contact, m; the frame's rim is deeper
_STILL = 0.1  # settling time before an image, s
_MIN_FORCE = 0.08  # minimum force for a shape estimate, N
_APPROACHES = 2
_OFF_CENTER = 5e-3  # distance of the contact from the sensor's center, m, for a second approach
_HOLDER = math.radians(35)
_TURNED_GROUP = -1  # group number of the patches touched with the object upside down
_SEAT_SD = 1e-4  # standard deviation of the offset after turning the object upside down, m


class SimulatedStage:
    """One sensor under a stage.

    Args:
        design: Sensor.
        model: Object.
        p_HO: (3,) Position of the object in the holder, m; hidden from the exploration.
        R_HO: (3, 3) Rotation of the object in the holder.
        mesh: Vertices of the simulated membrane.
        seed: Seed of the camera's noise.
        world: More options of the world (`timestep`, `effects`).
    """

    def __init__(
        self,
        design: SensorDesign,
        model: ObjectModel,
        *,
        p_HO: Array,
        R_HO: Array,
        seed: int = 0,
        **world,
    ):
        self.design = design
        self.world = ObjectOnStageWorld(
            design, ObjectOnStage(model, p_HO, R_HO), mesh=MESH, **world
        )
        # unknown offset of the object after it was turned upside down
        self._seat = _SEAT_SD * np.random.default_rng([seed, 32]).normal(size=3)
        self._view = View(self.world, design, seed=seed)
        self._uncertain = UncertainForceMonitor(["sensor"])
        take_references(self.world, [self._view], design.chamber.supply_gauge)

    @property
    def flags(self) -> Flags:
        """Flags of reduced accuracy of the simulation and of the estimated forces."""
        return merge_flags((self.world.flags, self._uncertain.flags))

    def is_reachable(self, aim: Aim) -> bool:
        """Return True if the sensor can reach the target. It always can: the area under the holder
        is touched with the object upside down."""
        return True

    def touch(self, aim: Aim, force: float) -> tuple[Pressed, ...]:
        """Touch one point until the contact force reaches `force`, N. The result is empty without
        contact."""
        R_SH = aim.R_SH()
        is_turned = aim.n_H[2] < -math.cos(_HOLDER)
        seat = R_SH @ self._seat if is_turned else np.zeros(3)
        p_H = self._above_center(R_SH, aim.p_H)
        touches: list[Touch] = []
        origins: list[Array] = []
        for touch in self._lower(R_SH, p_H):
            if touch.force_normal > _MIN_FORCE:
                touches.append(touch)
                origins.append(self.world.p_SH - seat)
            if not touch.force_normal < force:
                break
        self.world.lift_off()
        if not touches:
            return ()
        shape = self._view.perception.shape(touches)
        group, loose = (_TURNED_GROUP, _SEAT_SD) if is_turned else (0, 0.0)
        return (Pressed(tuple(touches), R_SH, np.array(origins), shape, group, loose),)

    def _above_center(self, R_SH: Array, p_H: Array) -> Array:
        """Find the first contact point with a light touch, and move it over the sensor's center."""
        for _ in range(_APPROACHES):
            for touch in self._lower(R_SH, p_H):
                if touch.contact is not None and touch.force_normal > _MIN_FORCE:
                    at = touch.contact.centroid
                    break
            else:
                return p_H
            if np.hypot(*at) < _OFF_CENTER:
                return p_H
            p_H = p_H + R_SH.T @ (at[0], at[1], 0.0)
        return p_H

    def _lower(self, R_SH: Array, p_H: Array) -> Iterator[Touch]:
        """Lower a point of the object in steps onto the sensor, and yield the touch of each."""
        self.world.turn(R_SH, p_H)
        depth = 0.0
        while depth < _TRAVEL:
            depth += _STEP
            self.world.drive(depth)
            self.world.step(round(_STILL / self.world.timestep))
            touch = self._view.touch()
            self._uncertain.on_touches(self.world.time, [touch])
            yield touch
