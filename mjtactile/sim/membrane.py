"""The rubber membrane as a MuJoCo flex: its mesh, its bodies in an `MjSpec`, its pre-stretch, and the markers on it.

Every interior vertex is a small body on three slide joints *in the sensor's own frame S*, child of the sensor's body;
the rim vertices belong to the sensor's body itself. Joint positions are therefore displacements in S, whatever
carries the sensor, and forces between membrane and frame need no bookkeeping (docs/equations.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from mjtactile.design import SensorDesign
from mjtactile.errors import InputError
from mjtactile.types import Array

FLEX, TENDON, BODY = "membrane", "gas", "sensor"

# Viscous resistance of the sheet against motion relative to its frame, N s/m per m^2 of sheet and per N/m of its
# stiffness (s/m^2). It stands for the rubber's internal friction, settles the shape in about 10 ms whatever the rubber,
# and conditions the solver: it joins the diagonal of the implicit system, which a membrane vertex of a few milligrams
# leaves almost empty; contact stiffness scales with that diagonal.
SURFACE_DAMPING = 27.0
SOFTEST = 100.0  # N/m; below this stiffness the damping stays, for the gas's sake
# Inertia against motion relative to the frame, kg/m^2, without weight: about three times the rubber's own mass.
SURFACE_ARMATURE = 0.8
# Contact: the share of the constraint that is rigid, and the depth over which it becomes so (MuJoCo `solimp`).
SOLIMP = (0.9995, 0.9995, 1e-4, 0.5, 2.0)


@dataclass(frozen=True, eq=False)
class MembraneMesh:
    """Regular triangle mesh of the flat, mounted membrane; vertex (i, j) has index i * ny + j, x grows with i.

    `p_SV` (n, 3) m, `triangles` (m, 3) counter-clockwise seen from outside (+z), `interior` (k,) vertex indices that
    move, `areas` (n,) m^2 of sheet that each vertex stands for.
    """

    nx: int
    ny: int
    p_SV: Array
    triangles: NDArray[np.int64]
    interior: NDArray[np.int64]
    areas: Array

    @property
    def x(self) -> Array:
        return self.p_SV[:: self.ny, 0]

    @property
    def y(self) -> Array:
        return self.p_SV[: self.ny, 1]


def make_mesh(length: float, width: float, nx: int, ny: int) -> MembraneMesh:
    """Mesh a `length` x `width` m rectangle with nx x ny vertices; diagonals alternate, so that no direction is favoured.

    Raises InputError when a side has fewer than 5 vertices (the cubic marker interpolation needs them) or more than
    101 (a step would take seconds).
    """
    for name, count in (("nx", nx), ("ny", ny)):
        if not 5 <= count <= 101:
            raise InputError(f"{count} vertices along a side, need 5 to 101", source="mesh", field=name)
    grid_x, grid_y = np.meshgrid(np.linspace(-length / 2, length / 2, nx), np.linspace(-width / 2, width / 2, ny),
                                 indexing="ij")
    p_SV = np.column_stack([grid_x.ravel(), grid_y.ravel(), np.zeros(nx * ny)])
    index = np.arange(nx * ny).reshape(nx, ny)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    even = np.add.outer(np.arange(nx - 1), np.arange(ny - 1)) % 2 == 0
    first = np.where(even[..., None], np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    second = np.where(even[..., None], np.stack([a, c, d], -1), np.stack([b, c, d], -1))
    triangles = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    areas = np.bincount(triangles.ravel(), minlength=nx * ny) * (length * width / len(triangles) / 3.0)
    return MembraneMesh(nx, ny, p_SV, triangles, index[1:-1, 1:-1].ravel(), areas)


def add_membrane(spec: mujoco.MjSpec, body: mujoco.MjsBody, design: SensorDesign, mesh: MembraneMesh) -> None:
    """Add the flex, its vertex bodies with contact spheres, and the gas tendon to `spec` under the sensor's `body`.

    Young's modulus is scaled by the square of the pre-stretch l: MuJoCo measures strain against the *mounted* mesh,
    E' = (L^2 - L0^2) / 2 L_mounted^2, which is 1/l^2 of the Green strain against the free sheet, and integrates over
    l^2 times the free sheet's area. The product leaves l^2 (see `SensorDesign.membrane.pretension`).
    """
    sheet = design.membrane
    names = [BODY] * len(mesh.p_SV)
    mass = mesh.areas * sheet.thickness * sheet.density / sheet.pre_stretch**2
    stiffness = max(sheet.young * sheet.thickness, 10 * sheet.pretension, SOFTEST)  # against stretch, against bulging
    damping = mesh.areas * SURFACE_DAMPING * stiffness
    armature = mesh.areas * SURFACE_ARMATURE
    for v in mesh.interior:
        names[v] = f"v{v}"
        vertex = body.add_body(name=names[v], pos=mesh.p_SV[v])
        vertex.mass, vertex.inertia, vertex.explicitinertial = mass[v], [mass[v] * 1e-8] * 3, True
        for axis, direction in zip("xyz", np.eye(3), strict=True):
            vertex.add_joint(name=names[v] + axis, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=direction,
                             damping=[damping[v], 0.0, 0.0], armature=armature[v])
        _add_contact_sphere(vertex, names[v], sheet.thickness / 2, sheet.friction)
    flex = spec.add_flex(name=FLEX)
    flex.dim, flex.radius, flex.thickness = 2, sheet.thickness / 2, sheet.thickness
    flex.young, flex.poisson, flex.damping = sheet.young * sheet.pre_stretch**2, sheet.poisson, 1e-9
    flex.elastic2d = 2  # stretching only: bending matters below about five thicknesses
    flex.vertbody, flex.elem = names, mesh.triangles.ravel().tolist()
    local = mesh.p_SV.copy()
    local[mesh.interior] = 0.0  # these vertices sit at their own body's origin
    flex.vert = local.ravel().tolist()
    flex.selfcollide, flex.contype, flex.conaffinity = 0, 0, 0  # the vertex spheres touch, the triangles do not
    flex.rgba = [0.92, 0.92, 0.9, 1.0]
    # The chamber: a fixed tendon over every vertex joint, whose coefficients become dV/dq at run time (chamber.py).
    tendon = spec.add_tendon(name=TENDON)
    tendon.stiffness = [1.0, 0.0, 0.0]
    tendon.springlength = [0.0, 0.0]
    for v in mesh.interior:
        for axis in "xyz":
            tendon.wrap_joint(f"{names[v]}{axis}", 1.0)


def _add_contact_sphere(vertex: mujoco.MjsBody, name: str, radius: float, friction: float) -> None:
    """Let the vertex be touched by whatever touches (contype 1), but not by other vertices or by frames.

    Friction and stiffness are the membrane's own (priority), not averaged with the object's.
    """
    vertex.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], mass=0.0, contype=0, conaffinity=1,
                    priority=1, condim=3, friction=[friction, 0.005, 0.0001], solimp=SOLIMP, group=4)


def pre_stretch(model: mujoco.MjModel, flex_id: int, mesh: MembraneMesh, stretch: float) -> None:
    """Shorten the flex's free edge lengths so that the mounted mesh is stretched by `stretch`; can be called again."""
    start, count = int(model.flex_edgeadr[flex_id]), int(model.flex_edgenum[flex_id])
    edges = np.asarray(model.flex_edge)[start:start + count]
    mounted = np.linalg.norm(mesh.p_SV[edges[:, 1]] - mesh.p_SV[edges[:, 0]], axis=1)
    model.flexedge_length0[start:start + count] = mounted / stretch


class MarkerInterpolator:
    """Where the rigid marker circles ride on the deformed mesh.

    Position and tangents come from a tensor-product cubic spline (not-a-knot) through the vertices, a fixed linear
    operator: the normals are smooth, where the facets' own would jump from triangle to triangle.
    """

    def __init__(self, mesh: MembraneMesh, p_SM: Array):
        """`p_SM` (N, 3) m: marker centres on the flat, mounted membrane."""
        value_x, slope_x = _spline_rows(mesh.x, p_SM[:, 0])
        value_y, slope_y = _spline_rows(mesh.y, p_SM[:, 1])

        def tensor(rows_x: Array, rows_y: Array) -> Array:
            return (rows_x[:, :, None] * rows_y[:, None, :]).reshape(len(p_SM), -1)

        self._operator = np.concatenate([tensor(value_x, value_y), tensor(slope_x, value_y), tensor(value_x, slope_y)])

    def marker_poses(self, p_SV: Array) -> tuple[Array, Array]:
        """Return centres `p_SM` (N, 3) m and outward unit normals `n_S` (N, 3) for vertex positions `p_SV` (n, 3)."""
        p_SM, along_x, along_y = (self._operator @ p_SV).reshape(3, -1, 3)
        normal = np.cross(along_x, along_y)
        return p_SM, normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _spline_rows(knots: Array, at: Array) -> tuple[Array, Array]:
    """Matrices (N, n) that take values at `knots` to spline values and slopes at `at`."""
    spline = make_interp_spline(knots, np.eye(len(knots)), k=3)
    return spline(at), spline.derivative()(at)
