"""Obstacles of the quasi-static membrane, each with a pose. SI units, frame S.

The kernel's format is that of kernels/qs_obstacles.c. Sizes are half sizes, as in MJCF. The surface
of an obstacle is its first intersection with a line along z, from the side of the glass. Undercuts
and slopes too steep for the membrane are ignored. This is exact for objects that approach from
outside. Their slopes at the contact may reach about 75 degrees. Objects that approach from the side
or hook under the membrane are outside the model.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.errors import InputError
from mjtactile.core.signature_checks import FINITE, validated
from mjtactile.core.types import Array

NUMBERS = 20
"""Entries of an obstacle: kind, sizes (3), R_SO (9), p_SO (3), pool start and count, width,
reach."""
POOL_START, POOL_COUNT = 16, 17

# Name: the kernel's code, and the meaning of `sizes`.
KINDS: dict[str, tuple[int, tuple[str, ...]]] = {
    "sphere": (0, ("radius",)),
    "capsule": (1, ("radius", "half length")),
    "ellipsoid": (2, ("semi-axis x", "semi-axis y", "semi-axis z")),
    "cylinder": (3, ("radius", "half length")),
    "box": (4, ("half x", "half y", "half z")),
    "plane": (5, ()),
    "quadric": (6, ("curvature x", "curvature y", "extent")),
    "disc": (7, ("radius", "half height", "rim radius")),
    "cone": (8, ("radius", "height")),
    "wedge": (9, ("half length", "half width", "height")),
    "mesh": (9, ()),
    "triangles": (10, ()),
    "heights": (11, ()),
}
_FEW = 16  # array size below which Python checks values faster than numpy
_UNIT = 0.01  # tolerance of the norm of a rounded quaternion
_FLAT = 1e-9  # extent that counts as no thickness, m
_SAME_PLANE = 9  # decimal digits of positions, m, and of normals
_MAY_VANISH = {"curvature x", "curvature y", "rim radius"}


@validated()
@dataclass(frozen=True, eq=False)
class Obstacle:
    """One obstacle in contact with a membrane.

    Attributes:
        kind: One of KINDS.
        parameters: (NUMBERS,) Parameters for the kernel.
        pool: Planes, triangles or heights of the obstacle.
        corners: Corners (n, 3), m, in its own frame, for kinds with a convex hull.
    """

    kind: str
    parameters: Array
    pool: Array
    corners: Array | None = None

    @validated(p_SO=FINITE, R_SO=FINITE)
    def at(self, p_SO: ArrayLike, R_SO: ArrayLike | None = None) -> Obstacle:
        """Return the obstacle at another pose, at a tenth of the cost of creating it.

        Args:
            p_SO: Position of the obstacle's center (3,), m, in S.
            R_SO: Its rotation in S, as for `obstacle`; None: unchanged.

        Returns:
            The obstacle at that pose.
        """
        row = self.parameters.copy()
        row[13:16] = finite("p_SO", p_SO, (3,))
        if R_SO is not None:
            row[4:13] = _rotation(R_SO)
        return Obstacle(self.kind, row, self.pool, self.corners)


def obstacle(
    kind: str,
    sizes: ArrayLike = (),
    p_SO: ArrayLike = (0.0, 0.0, 0.0),
    R_SO: ArrayLike | None = None,
    *,
    data: ArrayLike | None = None,
) -> Obstacle:
    """Create an obstacle with a pose.

    Args:
        kind: One of KINDS. The axis of capsule, cylinder, disc and cone is the obstacle's z. A
            cone's tip and a wedge's edge are at its origin, and both open towards z. A wedge's edge
            lies along x. A quadric is z >= (k_x x^2 + k_y y^2) / 2 out to `extent`. A plane is
            solid on the side away from the sensor.
        sizes: Half sizes, m (curvatures 1/m), in the order of KINDS.
        p_SO: Position of the obstacle's center (3,), m, in S.
        R_SO: Rotation, a matrix (3, 3) or a unit quaternion (4,), real part first; None: identity.
        data: For a mesh the vertices (n, 3), m, in the obstacle's frame, which define its convex
            hull. For triangles the corners (n, 3, 3), m. For heights the heights (nx, ny), m, over
            the membrane's nodes, infinite where there is no obstacle.

    Returns:
        The obstacle, for `QuasistaticMembrane.solve`.

    Raises:
        InputError: An unknown kind, a value that is not finite or not positive, or the wrong number
            of values.
    """
    if kind not in KINDS:
        raise InputError(f"{kind!r} is unknown", field="kind", choices=KINDS)
    kind_code, names = KINDS[kind]
    row = np.zeros(NUMBERS)
    row[0] = kind_code
    size = finite("sizes", sizes, (len(names),))
    sides = size.tolist()  # Python floats are faster: derivatives create many obstacles
    for name, value in zip(names, sides, strict=True):
        if (
            value < 0
            and name not in ("curvature x", "curvature y")
            or value == 0
            and name not in _MAY_VANISH
        ):
            raise InputError(f"{name} of {value:g} must be positive", field="sizes")
    row[1 : 1 + len(size)] = size
    row[4:13] = _rotation(R_SO)
    row[13:16] = finite("p_SO", p_SO, (3,))
    corners = _corners(kind, size, data)
    pool = _pool(kind, corners, data)
    if kind == "disc" and size[2] > min(size[0], size[1]):
        raise InputError(
            "the rim radius must not exceed the disc's radius and half height", field="sizes"
        )
    row[17] = len(pool)
    if kind == "heights":
        row[1:3] = np.shape(data)  # type: ignore[arg-type]
    row[18] = _min_width(kind, sides, data)
    row[19] = _extent(kind, sides, data)
    return Obstacle(kind, row, pool.ravel(), corners)


def unchecked_obstacle(
    kind: str,
    sizes: Sequence[float],
    p_SO: Sequence[float],
    R_SO: Array | None = None,
    heights: Array | None = None,
) -> Obstacle:
    """Create a "sphere", "ellipsoid", "cylinder" or "heights" without checks, for fits.

    `sizes` are as in `obstacle`, empty for `heights` (nx, ny) m, which must be finite.
    """
    turned = _IDENTITY.tolist() if R_SO is None else R_SO.ravel().tolist()
    sides = [0.0, 0.0, 0.0]
    sides[: len(sizes)] = sizes
    pool, minimum, extent = _NO_POOL.ravel(), 2 * min(sides[:2]), sum(sizes)
    if kind == "sphere":
        minimum = _min_width(kind, sides[:1], None)
    if heights is not None:
        sides[:2] = heights.shape
        pool, minimum, extent = heights.ravel(), math.inf, math.inf
    row = [KINDS[kind][0], *sides, *turned, *p_SO, 0.0, pool.size, minimum, extent]
    made = object.__new__(Obstacle)
    vars(made).update(kind=kind, parameters=np.array(row, dtype=float), pool=pool, corners=None)
    return made


def unchecked_obstacles(rows: Array, pool: Array | None) -> tuple[Obstacle, ...]:
    """Create the obstacles of `rows` (k, NUMBERS) without checks; their data are in `pool`."""
    found = []
    for row in rows:
        start, count = row[POOL_START : POOL_COUNT + 1].astype(int)
        own = _NO_POOL.ravel() if pool is None else pool[start : start + count]
        parameters = row.copy()
        parameters[POOL_START] = 0.0
        made = object.__new__(Obstacle)
        vars(made).update(kind=_BY_CODE[row[0]], parameters=parameters, pool=own, corners=None)
        found.append(made)
    return tuple(found)


def as_list(obstacles: Obstacle | Iterable[Obstacle], field: str) -> list[Obstacle]:
    """Return a list of one or several obstacles. Raises InputError that names `field`."""
    if isinstance(obstacles, Obstacle):
        return [obstacles]
    found: list[Obstacle] = list(obstacles) if isinstance(obstacles, Iterable) else [obstacles]
    for item in found:
        if not isinstance(item, Obstacle):
            raise InputError(
                f"{item!r} is not an obstacle; create it with QuasistaticMembrane.obstacle",
                field=field,
            )
    return found


def rows_and_pool(bodies: Sequence[Obstacle], grid: tuple[int, int]) -> tuple[Array, Array | None]:
    """Return the parameters (k, NUMBERS) of all obstacles and their pools, None if empty.

    Raises InputError if heights do not match the nodes of `grid`.
    """
    if len(bodies) == 1 and not bodies[0].pool.size:
        return bodies[0].parameters[None], None
    for body in bodies:
        if body.kind == "heights" and (shape := (*map(int, body.parameters[1:3]),)) != grid:
            raise InputError(f"heights have {shape} nodes, not {grid}", field="obstacle")
    rows = np.array([body.parameters for body in bodies]).reshape(-1, NUMBERS)
    sizes = [body.pool.size for body in bodies]
    if not any(sizes):
        return rows, None
    rows[:, POOL_START] = np.cumsum([0, *sizes[:-1]])
    return rows, np.concatenate([body.pool for body in bodies])


def _min_width(kind: str, size: list[float], data: ArrayLike | None) -> float:
    """Return the minimum width of an obstacle, m; infinite if it cannot pass between nodes."""
    if kind in ("mesh", "triangles"):
        wide = np.ptp(np.asarray(data, dtype=float).reshape(-1, 3), axis=0)
        return float(wide[wide > _FLAT].min(initial=np.inf))
    if kind in ("plane", "quadric", "heights", "cone"):
        return np.inf
    return 0.0 if kind == "wedge" else 2 * min(size[:2])


def _extent(kind: str, size: list[float], data: ArrayLike | None) -> float:
    """Return an upper bound of an obstacle's radius about its center, m."""
    if kind in ("mesh", "triangles"):
        return float(np.linalg.norm(np.asarray(data, dtype=float).reshape(-1, 3), axis=1).max())
    if kind in ("plane", "heights"):
        return np.inf
    if kind == "quadric":
        return size[2] * math.hypot(1.0, size[2] * max(abs(size[0]), abs(size[1])) / 2)
    return sum(size)


def _corners(kind: str, size: Array, data: ArrayLike | None) -> Array | None:
    """Return the corners (n, 3) of a wedge or a mesh; None for other kinds."""
    if kind == "wedge":
        length, width, height = size
        ends = [[x, y, height] for x in (-length, length) for y in (-width, width)]
        return np.array([[-length, 0.0, 0.0], [length, 0.0, 0.0], *ends])
    return finite("data", data, (-1, 3)) if kind == "mesh" and data is not None else None


def _pool(kind: str, corners: Array | None, data: ArrayLike | None) -> Array:
    if corners is not None:
        return _hull(corners)
    if kind not in ("mesh", "triangles", "heights"):
        if data is not None:
            raise InputError(f"a {kind} takes no data", field="data")
        return _NO_POOL
    if data is None:
        raise InputError(f"{kind} needs data", field="data")
    if kind == "heights":
        field = np.asarray(data, dtype=float)
        if field.ndim != 2 or np.isnan(field).any() or (field == -np.inf).any():
            raise InputError("heights must be (nx, ny), finite or +inf", field="data")
        return field.reshape(-1, 1)
    corners = finite("data", data, (-1, 3, 3)).reshape(-1, 9)
    if not len(corners):
        raise InputError("contains no triangle", field="data")
    return corners


def _hull(vertices: Array) -> Array:
    """Return the planes (m, 4), n x <= d, of the convex hull, one per face."""
    from scipy.spatial import ConvexHull, QhullError  # takes a tenth of a second to import

    try:
        equations = ConvexHull(vertices).equations
    except (QhullError, ValueError) as error:
        raise InputError("the vertices enclose no volume", field="data") from error
    _, first = np.unique(np.round(equations, _SAME_PLANE), axis=0, return_index=True)
    kept = equations[np.sort(first)]
    return np.column_stack([kept[:, :3], -kept[:, 3]])


_IDENTITY = np.eye(3).ravel()
_BY_CODE = {float(code): kind for kind, (code, _) in KINDS.items()}
_NO_POOL = np.zeros((0, 4))


def _rotation(R_SO: ArrayLike | None) -> Array:
    """Return the entries (9,) of a rotation matrix or quaternion, row by row. Raises InputError."""
    if R_SO is None:
        return _IDENTITY
    given = np.asarray(R_SO, dtype=float)
    if given.shape == (4,):
        length = float(np.linalg.norm(finite("R_SO", given, (4,))))
        if abs(length - 1) > _UNIT:
            raise InputError(f"is a quaternion of norm {length:g}, not 1", field="R_SO")
        w, x, y, z = given / length
        given = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ])  # fmt: skip
    R = finite("R_SO", given, (3, 3))
    x, y, z = R.tolist()
    errors = [_dot(x, x) - 1, _dot(y, y) - 1, _dot(z, z) - 1, _dot(x, y), _dot(y, z), _dot(z, x)]
    crossed = [y[1] * z[2] - y[2] * z[1], y[2] * z[0] - y[0] * z[2], y[0] * z[1] - y[1] * z[0]]
    if max(map(abs, errors)) > 1e-5 or _dot(x, crossed) < 0:
        raise InputError("is not a rotation", field="R_SO")
    return R.ravel()


def _dot(a: list[float], b: list[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def finite(field: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return `values` as a finite array of `shape` (-1: any). Raises InputError naming `field`."""
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError("is not an array of numbers", field=field) from error
    fits = array.shape == shape or (
        array.ndim == len(shape)
        and all(expected in (-1, have) for expected, have in zip(shape, array.shape, strict=True))
    )
    if not fits:
        requested = ", ".join("n" if expected < 0 else str(expected) for expected in shape)
        raise InputError(f"has shape {array.shape}, not ({requested})", field=field)
    if array.size < _FEW:
        known = all(map(math.isfinite, array.ravel().tolist()))
    else:
        known = bool(np.isfinite(array).all())
    if not known:
        raise InputError("is not finite", field=field)
    return array
