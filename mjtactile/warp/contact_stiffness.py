"""Contact stiffness of all membranes: derivatives of the wrench by the pose of the obstacles."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from mjtactile.warp.device.contact_stiffness import store_difference
from mjtactile.warp.membranes import Iteration
from mjtactile.warp.physics import Physics

_STEPS = np.array([2e-5, 2e-5, 2e-5, 2e-3, 2e-3, 2e-3])  # m and rad
_ITERATION = Iteration(outer=40, tolerance=1e-7)


class ContactStiffness:
    """Derivatives by six warm solutions of a copy of the membranes."""

    def __init__(self, physics: Physics):
        self._physics = physics
        self._copy = physics.copy(_ITERATION)
        count = physics.membranes.count
        self._start = wp.zeros((count, 6), dtype=float)
        self.matrix = wp.zeros((count, 6, 6), dtype=float)

    def find(self, m: Any, d: Any) -> None:
        """Write `matrix` (membranes, 6, 6) at the poses of the last step."""
        copy = self._copy
        copy.assign(self._physics)
        copy.update(m, d)
        start = copy.states.wrench
        wp.copy(self._start, start)
        for column, step in enumerate(_STEPS):
            twist = np.zeros(6)
            twist[column] = step
            copy.assign(self._physics)
            copy.update(m, d, twist)
            wp.launch(
                store_difference,
                dim=start.shape,
                inputs=[self._start, copy.states.wrench, column, float(step), self.matrix],
            )
