"""A simulated stage: an object in a holder, turned and lowered onto one sensor that looks up.

What the holder covers is touched after the object was put in the other way up: it sits a little
elsewhere then, which nobody knows.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array, ContactShape, Touch
from mjtactile.experiments.test_bench import View, take_references
from mjtactile.explore.next_best_touch import Aim
from mjtactile.explore.patch_from_touch import Pressed
from mjtactile.sim.scenes.object_on_stage import ObjectOnStage, ObjectOnStageWorld
from mjtactile.sim.scenes.objects import ObjectModel

MESH = (25, 21)
"""On which the simulated sheet has the shape that rubber has (`mjtactile press` says so, too)."""
_STEP = 2.5e-4  # m, by which the stage goes down between images
_TRAVEL = 2.6e-3  # m below first touch: before the frame's rim
_STILL = 0.1  # s that it stands before an image
_SEEN = 0.08  # N, from which on images tell of the body

Say = Callable[[str], None]


class SimulatedStage:
    """One sensor under a stage.

    Args:
        design: The sensor.
        model: The object.
        p_HO: (3,) m, where it is in the holder: nobody tells who explores.
        R_HO: (3, 3) how it is turned there.
        mesh: Vertices of the simulated sheet.
        seed: Of the camera's noise.
        world: More for the world (`timestep`, `effects`).
    """

    def __init__(
        self,
        design: SensorDesign,
        model: ObjectModel,
        *,
        p_HO: Array,
        R_HO: Array,
        mesh: tuple[int, int] = MESH,
        seed: int = 0,
        **world,
    ):
        self.design = design
        self.world = ObjectOnStageWorld(
            design, ObjectOnStage(model, p_HO, R_HO), mesh=mesh, **world
        )
        # how the object sits when it was put in the other way up, which nobody knows
        self._seat = _SEAT_SD * np.random.default_rng([seed, 32]).normal(size=3)
        self._view = View(self.world, design, seed=seed)
        take_references(self.world, [self._view], design.chamber.supply_gauge)

    @property
    def flags(self) -> dict[str, str]:
        """What makes the simulation's numbers worse than usual."""
        return dict(self.world.flags)

    def reaches(self, aim: Aim) -> bool:
        """Whether the sensor gets there: what the holder covers is touched after it was put in the
        other way up."""
        return True

    def touch(self, aim: Aim, force: float) -> tuple[Pressed, ...]:
        """Touch at one place.

        Args:
            aim: Where.
            force: N, up to which the object is pressed.

        Returns:
            The press; nothing where nothing was felt.
        """
        R_SH = aim.R_SH()
        is_over = aim.n_H[2] < -math.cos(_HOLDER)
        seat = R_SH @ self._seat if is_over else np.zeros(3)
        p_H = self._above_center(R_SH, aim.p_H)
        self.world.turn(R_SH, p_H)
        touches: list[Touch] = []
        places: list[Array] = []
        depth = 0.0
        while depth < _TRAVEL:
            depth += _STEP
            self._lower(depth)
            touch = self._view.touch()
            felt = touch.force_normal
            if math.isfinite(felt) and felt > _SEEN:
                touches.append(touch)
                places.append(self.world.p_SH - seat)
            if not math.isfinite(felt) or felt >= force:
                break
        self.world.lift_off()
        if not touches:
            return ()
        shape: ContactShape = self._view.perception.shape(touches)
        group, loose = (_OVER, _SEAT_SD) if is_over else (0, 0.0)
        return (Pressed(tuple(touches), R_SH, np.array(places), shape, group, loose),)

    def _above_center(self, R_SH: Array, p_H: Array) -> Array:
        """Feel lightly where the object is first met, and have that over the sensor's middle."""
        for _ in range(_LOOKS):
            self.world.turn(R_SH, p_H)
            depth = 0.0
            while depth < _TRAVEL:
                depth += _STEP
                self._lower(depth)
                touch = self._view.touch()
                if touch.contact is not None and touch.force_normal > _SEEN:
                    break
            else:
                return p_H
            at = touch.contact.centroid
            if np.hypot(*at) < _ASIDE:
                return p_H
            p_H = p_H + R_SH.T @ (at[0], at[1], 0.0)
        return p_H

    def _lower(self, depth: float) -> None:
        self.world.drive(depth)
        self.world.step(round(_STILL / self.world.timestep))


_LOOKS = 2
_ASIDE = 5e-3  # m from the sensor's middle, from where on another look is worth it
_HOLDER = math.radians(35)
_OVER = -1  # the group of patches that were touched the other way up
_SEAT_SD = 1e-4  # m, by which the object then sits elsewhere
