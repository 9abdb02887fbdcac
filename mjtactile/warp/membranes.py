"""`Membranes`: many quasi-static membranes of one sensor on one device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.quasistatic.membrane import QuasistaticMembrane
from mjtactile.sim.sensor.quasistatic_geoms import bulge_stiffness, membrane_of
from mjtactile.warp.arrays import ints
from mjtactile.warp.cut_cells import cut_cells
from mjtactile.warp.device.equilibrium import solve_all
from mjtactile.warp.device.fields import Fields, Scheme
from mjtactile.warp.device.gas import Gas
from mjtactile.warp.device.grid import MembraneGrid
from mjtactile.warp.device.obstacles import Geom
from mjtactile.warp.device.relaxation import MAX_NODES
from mjtactile.warp.stencil import plane_stencil

BLOCK = 64  # threads of a membrane on a GPU


@dataclass(frozen=True)
class Iteration:
    """Iteration of a solution.

    `outer` limits the outer steps of one solution. Each relaxes the heights in `batches`, with the
    gas pressure updated after each, then the in-plane displacements. `sweeps` are the numbers of
    sweeps in a batch and in the plane. A solution ends when a step is below `tolerance`, m.
    """

    outer: int = 4
    batches: int = 5
    sweeps: tuple[int, int] = (5, 4)
    relaxation: tuple[float, float] = (1.6, 1.2)
    tolerance: float = 1e-6


class Membranes:
    """`count` membranes of one sensor, each with up to `slots` geoms near it.

    `geoms` (count, slots) are obstacles in each sensor's frame. A kind of -1 is an empty slot.
    `fields` holds state and results. `modulus` (count,) scales the shear modulus times thickness.
    """

    def __init__(
        self,
        sensor: SensorDesign | str,
        count: int,
        *,
        slots: int = 1,
        grid: tuple[int, int] = (21, 16),
        device: str | None = None,
        iteration: Iteration | None = None,
        planes: Array | None = None,
    ):
        """Create the membranes, inflated and sealed at the sensor's supply pressure.

        Args:
            sensor: The sensor's design, or a shipped name.
            count: Number of membranes.
            slots: Number of geoms that may be near one membrane.
            grid: Number of nodes along x and y. The product is at most MAX_NODES.
            device: Warp device, such as "cpu" or "cuda:0"; None: Warp's default.
            iteration: Iteration of a solution; None: the default.
            planes: Planes (n, 4) of convex geoms: outward normal and distance, m.

        Raises:
            InputError: A grid with too many nodes, or a sensor whose membrane finds no equilibrium.
        """
        if grid[0] * grid[1] > MAX_NODES:
            raise InputError(
                f"{grid} has {grid[0] * grid[1]} nodes; at most {MAX_NODES}", field="grid"
            )
        self.design = load_sensor(sensor)
        self.membrane = membrane_of(self.design, grid)
        self.count, self.grid = count, grid
        self.device = wp.get_device(device)
        self.block = BLOCK if self.device.is_cuda else 1
        self.iteration = iteration or Iteration()
        with wp.ScopedDevice(self.device):
            self.rubber = _membrane(self.membrane)
            self.scheme = new_scheme(self.membrane, self.iteration)
            self.fields = new_fields(count, grid)
            self.gas = Gas()
            self.gas.flat = float(self.design.chamber_volume_flat)
            self.gas.ambient = float(self.design.chamber.ambient)
            self.gas.exponent = float(self.design.chamber.polytropic_exponent)
            self.gas.amount = wp.full(count, float(self.membrane._gas), dtype=float)
            self.gas.sealed = wp.full(count, int(self.membrane.sealed), dtype=int)
            self.modulus = wp.full(count, 1.0, dtype=float)
            self.geoms: Any = wp.zeros((count, slots), dtype=Geom)
            rows = np.zeros((1, 4)) if planes is None else planes
            self.pool = wp.array(rows.astype(np.float32), dtype=wp.vec4)
        empty = self.geoms.numpy()
        empty["kind"] = -1
        self.geoms.assign(empty)
        self.reset()

    def reset(self) -> None:
        """Return all membranes to rest without contact."""
        rest = self.membrane.rest
        x = rest.x.reshape(3, -1).astype(np.float32)
        repeated = np.broadcast_to(x, (self.count, *x.shape))
        for field in (self.fields.u, self.fields.kept):
            field.assign(repeated)
        self.fields.force.zero_()
        self.fields.kept_force.zero_()
        self.fields.pressure.fill_(float(self.membrane.gauge_pressure))
        self.fields.volume.fill_(float(rest.volume))
        self.fields.status.zero_()
        self.fields.lost.zero_()
        self.fields.gain.fill_(1.0)

    def solve(self) -> None:
        """Solve for the equilibrium of all membranes on their geoms, from their present states."""
        wp.launch_tiled(
            solve_all,
            dim=[self.count],
            inputs=[
                self.rubber,
                self.scheme,
                self.gas,
                self.geoms,
                self.pool,
                self.modulus,
                self.fields,
            ],
            block_dim=self.block,
            device=self.device,
        )


def _membrane(membrane: QuasistaticMembrane) -> Any:
    constants = membrane._constants
    rubber = MembraneGrid()
    rubber.nx, rubber.ny = membrane.grid
    rubber.dx = float(membrane.x[1] - membrane.x[0])
    rubber.dy = float(membrane.y[1] - membrane.y[0])
    rubber.lambda2 = float(constants[4])
    rubber.neo_hookean = int(constants[5])
    rubber.modulus, rubber.poisson = float(constants[6]), float(constants[7])
    rubber.law_middle, rubber.law_per_unit = float(constants[8]), float(constants[9])
    rubber.half_thickness = membrane.design.membrane.thickness / 2
    rubber.depth, rubber.roof = membrane.design.chamber.depth, membrane.roof
    rubber.law = wp.array(membrane._law.astype(np.float32), dtype=float)
    rubber.opening = float(constants[-2])
    rubber.cut, nodes = cut_cells(membrane)
    rubber.free = ints(nodes)
    rest = membrane.rest.x.reshape(3, -1).astype(np.float32)
    rubber.rest = wp.array(rest, dtype=float)
    rubber.stencil = wp.array(plane_stencil(membrane).astype(np.float32), dtype=float)
    return rubber


def new_scheme(membrane: QuasistaticMembrane, iteration: Iteration) -> Any:
    """Return the iteration for the device."""
    scheme = Scheme()
    scheme.outer = iteration.outer
    scheme.batches = iteration.batches
    scheme.sweeps_z, scheme.sweeps_xy = iteration.sweeps
    scheme.relaxation_z, scheme.relaxation_xy = iteration.relaxation
    scheme.tolerance = iteration.tolerance
    scheme.bulge = 1 / bulge_stiffness(membrane)
    return scheme


def new_fields(count: int, grid: tuple[int, int]) -> Any:
    """Return state and workspace of `count` membranes."""
    nodes = grid[0] * grid[1]
    fields = Fields()
    for name in ("u", "kept"):
        setattr(fields, name, wp.zeros((count, 3, nodes), dtype=float))
    for name in (
        *(
            "force",
            "kept_force",
            "height",
            "slope_x",
            "slope_y",
            "gap",
            "change",
            "step_before",
            "link_x",
            "link_y",
        ),
        *("rx", "ry", "rz", "swell", "extra", "next_fraction"),
    ):
        setattr(fields, name, wp.zeros((count, nodes), dtype=float))
    for name in ("owner", "next_slot"):
        setattr(fields, name, wp.zeros((count, nodes), dtype=int))
    fields.spring = wp.zeros((count, 4, nodes), dtype=float)
    fields.away = wp.zeros((count, 2, nodes), dtype=float)
    for name in ("pressure", "volume", "gain"):
        setattr(fields, name, wp.zeros(count, dtype=float))
    for name in ("status", "iterations", "lost"):
        setattr(fields, name, wp.zeros(count, dtype=int))
    return fields
