"""Membrane of a sensor with the nodes that carry tractions. The nodes lie on the inner lines of a
regular grid in the membrane's parametric coordinates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.bspline import hats
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.sensing.force.linearization import Shape
from mjtactile.sensing.force.rest_equilibrium import MarkedMembrane
from mjtactile.sensing.force.spline_fem import product
from mjtactile.sensing.settings import InverseSettings

REFINE = 5  # cells of the fine grid, for outlines, to a cell of the traction grid


class LoadedMembrane(MarkedMembrane):
    """Membrane of one sensor, with its markers and J nodes. The nodes lie on its inner grid lines
    `x` (nx,), `y` (ny,), m."""

    def __init__(self, design: SensorDesign, settings: InverseSettings):
        super().__init__(design, settings)
        ax, ay = self.membrane.axes
        self.x = ax.breaks
        self.y = ay.breaks
        hat_x = hats(self.x, ax.points)[0][:, 1:-1]
        hat_y = hats(self.y, ay.points)[0][:, 1:-1]
        self._hats = (hat_x, hat_y)
        parametric = product(self.x[1:-1], self.y[1:-1])
        # Areas (J,), m^2, in parametric coordinates, and the ratio of mounted to parametric area.
        # Kernels take tractions per parametric area, so that their integrals are products.
        self._cells = np.outer(ax.weights @ hat_x, ay.weights @ hat_y).ravel()
        self._density = self.membrane.density(parametric)
        self.node_area = self._cells * self._density  # (J,) m^2
        self.nodes = self.membrane.positions(parametric)
        self._flat_nodes = np.column_stack([self.nodes, np.zeros(len(self.nodes))])
        self._at_nodes = self.membrane.basis(parametric)
        self._shared = self._sharing()
        fine_x = np.linspace(-ax.length / 2, ax.length / 2, REFINE * ax.spans + 1)
        fine_y = np.linspace(-ay.length / 2, ay.length / 2, REFINE * ay.spans + 1)
        self._at_fine = (ax.at(fine_x), ay.at(fine_y))
        fine = self.membrane.positions(product(fine_x, fine_y))
        self._fine = fine.T.reshape(2, len(fine_x), len(fine_y))

    def node_loads(self) -> tuple[Array, Array]:
        """Return the generalized forces (kx, jx), (ky, jy) of 1 Pa at each node, along x and y."""
        ax, ay = self.membrane.axes
        hat_x, hat_y = self._hats
        along_x = (ax.at(ax.points) * ax.weights[:, None]).T @ hat_x
        along_y = (ay.at(ay.points) * ay.weights[:, None]).T @ hat_y
        return along_x, along_y

    def force(self, shape: Shape) -> Array:
        """Return the net force (3,), N, on the membrane."""
        return shape.traction @ self.node_area

    def node_positions(self, c: Array) -> Array:
        """Return the current node positions (J, 3), m, frame S."""
        return self._flat_nodes + self._at_nodes @ c.T

    def fine_positions(self, c: Array) -> Array:
        """Return the current positions of the fine grid points (3, a, b), m, frame S."""
        moved = self._at_fine[0] @ c.reshape(3, *self.membrane.shape) @ self._at_fine[1].T
        moved[:2] += self._fine
        return moved

    def pressing_at_points(self, shape: Shape) -> Array:
        """Return the contact force per cell at the membrane's Gauss points (qx, qy), N; never
        negative."""
        hat_x, hat_y = self._hats
        pressure = np.maximum(-shape.traction[2], 0.0) * self._density
        pressure = pressure.reshape(hat_x.shape[1], hat_y.shape[1])
        return self.membrane.cells * (hat_x @ pressure @ hat_y.T)

    def _to_regular_grid(self, force: Array) -> Array:
        """Return the nodal forces (3, J), N, on the regular grid of `Traction`, (ny, nx, 3). The
        force of a node between grid lines is distributed so that sum and position are kept."""
        nodal = np.zeros((len(self.y), len(self.x), 3))
        if self._shared is None:
            inner = force.reshape(3, len(self.x) - 2, len(self.y) - 2)
            nodal[1:-1, 1:-1] = inner.transpose(2, 1, 0)
            return nodal
        for rows, columns, fraction in self._shared:
            np.add.at(nodal, (rows, columns), fraction[:, None] * force.T)
        return nodal

    def _sharing(self) -> list[tuple[NDArray[np.int64], NDArray[np.int64], Array]] | None:
        """Return rows, columns and weights (J,) of the four grid positions around each node."""
        if self.design.frame.outline is None:
            return None
        neighbors = []
        for lines, at in zip((self.x, self.y), self.nodes.T, strict=True):
            step = (at - lines[0]) / (lines[1] - lines[0])
            first = np.clip(step.astype(np.int64), 0, len(lines) - 2)
            neighbors.append(((first, 1 - step + first), (first + 1, step - first)))
        return [(row, column, by * bx) for column, bx in neighbors[0] for row, by in neighbors[1]]
