"""Export of an explored surface: PLY with the uncertainty of each vertex, and STL for printing."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mjtactile.core.types import Array
from mjtactile.explore.exploration import ExplorationResult
from mjtactile.fabrication.mesh import write_stl as stl_of

SOFT = 4e-3
"""Compliance with the color of the softest material, m/N."""
_STIFF_COLOUR = np.array([58, 96, 170])
_SOFT_COLOUR = np.array([214, 72, 56])
_UNKNOWN_COLOUR = np.array([150, 150, 150])


def colours(compliance: Array) -> Array:
    """Return colors (V, 3) uint8: blue is stiff, red is soft, gray is unknown."""
    fraction = np.clip(np.sqrt(np.maximum(np.nan_to_num(compliance), 0.0) / SOFT), 0, 1)[:, None]
    mixed = (1 - fraction) * _STIFF_COLOUR + fraction * _SOFT_COLOUR
    known = np.isfinite(compliance)[:, None]
    return np.where(known, mixed, _UNKNOWN_COLOUR).round().astype(np.uint8)


def write_ply(path: Path, found: ExplorationResult) -> None:
    """Write the surface in mm, binary: vertices with normals, `sd` mm, `compliance` mm/N, color."""
    mesh = found.mesh
    named = [
        *((name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz", "sd", "compliance")),
        *((name, "u1") for name in ("red", "green", "blue")),
    ]
    rows = np.zeros(len(mesh.vertices), named)
    compliance = found.stiffness.by_vertex
    values = [
        1e3 * mesh.vertices,
        mesh.normals,
        1e3 * mesh.sd,
        1e3 * compliance,
        colours(compliance),
    ]
    for (name, _), column in zip(named, np.column_stack(values).T, strict=True):
        rows[name] = column
    faces = np.zeros(len(mesh.triangles), [("count", "u1"), ("at", "<i4", 3)])
    faces["count"] = 3
    faces["at"] = mesh.triangles
    kinds = {"<f4": "float", "u1": "uchar"}
    head = [
        "ply",
        "format binary_little_endian 1.0",
        "comment mjtactile explore: mm, sd mm, compliance mm/N",
        f"element vertex {len(rows)}",
        *(f"property {kinds[kind]} {name}" for name, kind in named),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    path.write_bytes("\n".join([*head, ""]).encode("ascii") + rows.tobytes() + faces.tobytes())


def write_stl(path: Path, found: ExplorationResult) -> None:
    """Write the surface in mm, binary."""
    corners = 1e3 * found.mesh.vertices[found.mesh.triangles]
    path.write_bytes(stl_of(corners, b"mjtactile explore, mm"))
