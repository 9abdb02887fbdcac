"""Triangles of a `Part` by manifold3d, which are closed and consistent, and STL files of them."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from itertools import combinations
from typing import Any

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.fabrication.layered_solid import Layer, Part

PER_QUARTER = 16  # chords of a quarter circle in files (0.12 % radius error)
COARSE = 6  # chords of a quarter circle in images
_TOUCH = 1e-3  # mm^3 that rounding may make of faces that touch


def require_libraries() -> None:
    """Raise InputError with installation instructions if libraries are missing."""
    missing = [name for name in ("manifold3d", "matplotlib") if find_spec(name) is None]
    if missing:
        need = f"needs {' and '.join(missing)}: pip install 'mjtactile[fabrication]'"
        raise InputError(need, source="fabricate")


def solid_of(part: Part, per_quarter: int = PER_QUARTER) -> Any:
    """Build the part as a `manifold3d.Manifold`, mm."""
    import manifold3d as m3

    solid = m3.Manifold.batch_boolean(
        [_extrude(layer, per_quarter) for layer in part.layers], m3.OpType.Add
    )
    if bore := part.bore:
        start, end = bore.ends
        length = end - start + 2
        tool = m3.Manifold.cylinder(length, bore.radius, circular_segments=4 * per_quarter)
        solid = solid - tool.rotate((0, 90, 0)).translate((start - 1, bore.y, bore.z))
    return solid


def _extrude(layer: Layer, per_quarter: int) -> Any:
    import manifold3d as m3

    polygons = []
    for region in layer.regions:
        polygons.append(region.outer.polygon(per_quarter))
        polygons += [hole.polygon(per_quarter)[::-1] for hole in region.holes]
    solid = m3.CrossSection(polygons, m3.FillRule.Positive).extrude(layer.high - layer.low)

    def to_its_heights(points: Array) -> Array:
        """Set the heights exactly, so that touching layers are one solid."""
        return np.column_stack([points[:, :2], np.where(points[:, 2] > 0, layer.high, layer.low)])

    return solid.warp_batch(to_its_heights)


def triangles_of(solid: Any) -> Array:
    """Return the triangles' corners (n, 3, 3), mm, counter-clockwise from outside."""
    mesh = solid.to_mesh64()
    return np.asarray(mesh.vert_properties)[:, :3][np.asarray(mesh.tri_verts)]


def write_stl(triangles: Array, title: bytes = b"mm") -> bytes:
    """Return a binary STL file of triangles (n, 3, 3)."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    rows = np.zeros(len(triangles), np.dtype([("numbers", "<f4", 12), ("none", "<u2")]))
    rows["numbers"] = np.concatenate([normals, triangles.reshape(-1, 9)], axis=1)
    return title.ljust(80) + np.uint32(len(triangles)).tobytes() + rows.tobytes()


def overlaps(solids: Mapping[str, Any]) -> list[tuple[str, str, float]]:
    """Return the pairs of parts that intersect, and their common volumes, mm^3."""
    found = []
    boxes = {name: np.reshape(solid.bounding_box(), (2, 3)) for name, solid in solids.items()}
    for (first, a), (other, b) in combinations(solids.items(), 2):
        low = np.maximum(boxes[first][0], boxes[other][0])
        high = np.minimum(boxes[first][1], boxes[other][1])
        if (low >= high).any():
            continue
        volume = (a ^ b).volume()
        if volume > _TOUCH:
            found.append((first, other, volume))
    return found
