"""Objects that deform by finite elements, written as MJCF files with a volumetric flex.

The format is that of docs/reference/object_files.md. MuJoCo's interpolated elements (decision 12)
form a lattice of `cells` trilinear cells over the bounding box. Each cell is linear-elastic in a
frame that rotates with it. The finer mesh of tetrahedra is for contact and display. Contact occurs
`skin` m above it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations, product
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array

# distance of the four pegs of a cup from the axis, x and y, m; the fingers close along x
_CUP = (0.0035, 0.007)
_PEG = 0.0015  # radius of a peg, m
_UNIT = 1e-5  # unit of the integer point coordinates, m

Shape = Literal["block", "ball", "thimble"]


@dataclass(frozen=True)
class SoftBody:
    """Soft object with a `shape` of half sizes `half` (x, y, z) m, including its skin.

    A "ball" is an ellipsoid. A "thimble" is hollow and open below, with walls of `wall` m. The
    material has `young` Pa, `poisson`, `density` kg/m^3 and `damping` s (over stiffness). The
    strength applies to the twentieth of the volume under the highest load, as `break_stress` Pa
    (von Mises) or `break_energy` J/m^3. `lattice` (3,) are the deforming cells, `mesh` the number
    of tetrahedral cells along an edge (even).
    """

    shape: Shape
    half: tuple[float, float, float]
    young: float
    poisson: float
    density: float
    break_stress: float = 0.0
    break_energy: float = 0.0
    damping: float = 0.01
    wall: float = 0.0
    skin: float = 5e-4
    lattice: tuple[int, int, int] = (3, 3, 3)
    mesh: int = 6
    centre_height: float = 0.032  # height over the table, m: the sensors' frames stay clear of it
    rgba: str = "0.9 0.85 0.7 1"

    @property
    def volume(self) -> float:
        """Volume of the object with its skin, m^3."""
        points, elements = tetrahedra(self)
        inner = float(tetrahedron_volumes(points, elements).sum())
        size = np.asarray(self.half)
        return inner * float(np.prod(size) / np.prod(size - self.skin))


def tetrahedra(body: SoftBody) -> tuple[Array, NDArray[np.int64]]:
    """Return points (n, 3) m below the skin, about the center, and tetrahedra (m, 4)."""
    n = body.mesh
    line = np.linspace(-1.0, 1.0, n + 1)
    grid = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    cells = [
        cell for cell in product(range(n), repeat=3) if _SHAPES[body.shape][1](np.array(cell), n)
    ]
    points = _SHAPES[body.shape][0](grid, body)
    elements = _tetrahedra(cells, n)
    used, elements = np.unique(elements, return_inverse=True)
    points = points[used]
    elements = elements.reshape(-1, 4)
    turned = tetrahedron_volumes(points, elements) < 0
    elements[turned] = elements[turned][:, [0, 2, 1, 3]]
    return points, elements


def tetrahedron_volumes(points: Array, elements: NDArray[np.int64]) -> Array:
    """Return the volumes (m,), m^3, of tetrahedra; negative for inverted ones."""
    a, b, c, d = (points[elements[:, k]] for k in range(4))
    return np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6


def _tetrahedra(cells: list[tuple[int, ...]], n: int) -> NDArray[np.int64]:
    """Return six tetrahedra (m, 4) per cell, along its diagonal, with common faces."""
    corners = []
    for cell, order in product(cells, permutations(range(3))):
        corner = list(cell)
        path = []
        for axis in (None, *order):
            if axis is not None:
                corner[axis] += 1
            path.append((corner[0] * (n + 1) + corner[1]) * (n + 1) + corner[2])
        corners.append(path)
    return np.array(corners, dtype=np.int64)


def _block(grid: Array, body: SoftBody) -> Array:
    return grid * (np.array(body.half) - body.skin)


def _ball(grid: Array, body: SoftBody) -> Array:
    """Map shells of the cube to shells of the ellipsoid, by equal angles."""
    direction, level = _directions(grid)
    return direction * level[:, None] * (np.array(body.half) - body.skin)


def _thimble(grid: Array, body: SoftBody) -> Array:
    """Map the cube's outer shells, those beyond a third, to the wall."""
    direction, level = _directions(grid)
    hollow = 2 * ((body.mesh // 3 + 1) // 2) / body.mesh  # the innermost shell that is kept
    depth = np.clip((1 - level) / (1 - hollow), 0.0, 1.0)[:, None]  # 0 outside, 1 inside
    outer = np.array(body.half) - body.skin
    return direction * (outer - depth * (body.wall - 2 * body.skin))


def _directions(grid: Array) -> tuple[Array, Array]:
    """Return even unit vectors (n, 3) to the points of a cube, and the shells (n,)."""
    level = np.abs(grid).max(axis=1)
    direction = np.tan(np.pi / 4 * grid / np.where(level > 0, level, 1.0)[:, None])
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    return direction / np.where(length > 0, length, 1.0), level


def _in_wall(cell: NDArray[np.int64], n: int) -> bool:
    """Return True if a cell of the cube is neither in a thimble's hollow nor in its hole."""
    x, y, z = np.abs(2 * cell + 1 - n)  # 1, 3, ... n - 1
    hole = cell[2] < n / 2 and z > max(x, y) and max(x, y) < 2 * n / 3
    return bool(max(x, y, z) > n / 3) and not hole


_SHAPES: dict[
    str, tuple[Callable[[Array, SoftBody], Array], Callable[[NDArray[np.int64], int], bool]]
] = {
    "block": (_block, lambda cell, n: True),
    "ball": (_ball, lambda cell, n: True),
    "thimble": (_thimble, _in_wall),
}


def to_mjcf(body: SoftBody, name: str, comment: str = "") -> str:
    """Return the object's file as MJCF."""
    limits = {
        "break_stress_kPa": 1e-3 * body.break_stress,
        "break_energy_kJ_m3": 1e-3 * body.break_energy,
        "true_modulus_kPa": 1e-3 * body.young,
    } | ({"rotation_deg": 2.0} if body.shape == "block" else {})
    numerics = "\n".join(
        f'    <numeric name="{key}" data="{value:.6g}"/>' for key, value in limits.items() if value
    )
    points, elements = tetrahedra(body)
    mesh = (
        f'scale="{_UNIT:g} {_UNIT:g} {_UNIT:g}"\n          '
        f'point="{_rows(np.round(points / _UNIT).astype(int))}"\n'
        f'          element="{_rows(elements)}"'
    )
    return f"""<!-- {comment or name}
     Units: m, kg, N, s, Pa. Finite elements, made by mjtactile.sim.scenes.soft_bodies;
     docs/reference/object_files.md says how far they go.
     The mesh of tetrahedra is what touches and is seen;
     the lattice of {"x".join(map(str, body.lattice))} cells is what deforms.
     young, poisson, damping, mass and scale (the size) can be changed here. -->
<mujoco model="{name}">
  <custom>
{numerics}
    <numeric name="grasp_height_m" data="{body.centre_height:g}"/>
    <text name="material" data="soft"/>
  </custom>
  <worldbody>
{_cup(body) if body.shape == "ball" else _stand(body, float(points[:, 2].min()))}
    <body name="object" pos="0 0 {body.centre_height:g}">  <!-- no joint: a flex moves by itself -->
      <flexcomp name="flesh" type="direct" dim="3" dof="trilinear"
                cellcount="{" ".join(map(str, body.lattice))}"
                mass="{body.density * body.volume:.4g}" radius="{body.skin:g}"
                rgba="{body.rgba}" {mesh}>
        <elasticity young="{body.young:g}" poisson="{body.poisson:g}" damping="{body.damping:g}"/>
        <contact selfcollide="none" contype="1" conaffinity="0" friction="0.3 0.005 0.0001"
                 solref="0.008 1" solimp="0.99 0.999 0.0005" solmix="100"/>
        <!-- stiff: contact softness is by inverse mass -->
      </flexcomp>
    </body>
  </worldbody>
</mujoco>
"""


def _rows(ids: NDArray[np.int64], columns: int = 110) -> str:
    """Return the integers as text in lines of limited width."""
    lines = [""]
    for row in ids:
        text = " ".join(map(str, row))
        if len(lines[-1]) + len(text) > columns:
            lines.append("")
        lines[-1] += text + "  "
    return "\n          ".join(line.strip() for line in lines)


def _stand(body: SoftBody, bottom: float) -> str:
    """Return a stand half as wide as the object, whose lower side is at `bottom` m."""
    height = body.centre_height + bottom - body.skin
    radius = 0.5 * min(body.half[:2])
    return f"""    <body name="stand">
      <geom name="stand" type="cylinder" pos="0 0 {height / 2:.5g}"
            size="{radius:g} {height / 2:.5g}" friction="0.3 0.005 0.0001"
            rgba="0.6 0.6 0.65 1"/>
    </body>"""


def _cup(body: SoftBody) -> str:
    """Return four pegs that support an ellipsoid with its center at the grasp height."""
    grown = np.array(body.half) + _PEG
    x, y = _CUP
    top = body.centre_height - grown[2] * np.sqrt(1 - (x / grown[0]) ** 2 - (y / grown[1]) ** 2)
    pegs = [
        f'      <geom name="peg{k}" type="capsule" fromto="{sx * x:g} {sy * y:g} 0 {sx * x:g} '
        f'{sy * y:g} {top:.5g}" '
        f'size="{_PEG:g}" friction="0.3 0.005 0.0001" rgba="0.6 0.6 0.65 1"/>'
        for k, (sx, sy) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1)))
    ]
    return "\n".join(['    <body name="cup">', *pegs, "    </body>"])


SHIPPED: dict[str, tuple[SoftBody, str]] = {
    "tofu": (
        SoftBody(
            "block",
            (0.014, 0.010, 0.010),
            young=2e4,
            poisson=0.45,
            density=1050.0,
            break_stress=4e3,
            mesh=4,
            rgba="0.95 0.93 0.85 1",
        ),
        "A block of tofu-like gel (12 g) on a stand, E = 20 kPa. It breaks at a von "
        "Mises stress of 4 kPa.",
    ),
    "raspberry": (
        SoftBody(
            "thimble",
            (0.010, 0.010, 0.011),
            young=1.5e5,
            poisson=0.4,
            density=950.0,
            break_energy=1.5e3,
            wall=0.0045,
            lattice=(4, 4, 4),
            rgba="0.8 0.12 0.28 1",
        ),
        "A raspberry without its core: a soft hull, open below, E = 150 kPa. It "
        "tears at 1.5 kJ/m^3 of strain.",
    ),
    "silicone_ball": (
        SoftBody(
            "ball",
            (0.012, 0.012, 0.012),
            young=1.2e5,
            poisson=0.45,
            density=1070.0,
            break_stress=1e6,
            lattice=(4, 4, 4),
            rgba="0.35 0.6 0.75 1",
        ),
        "A ball of soft silicone, E = 120 kPa. It tears at 1 MPa, which no gripper here reaches.",
    ),
}
"""Soft objects shipped in models/objects, with the first sentence of their file."""
