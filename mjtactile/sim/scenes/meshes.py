"""Shapes from mesh files. MuJoCo uses a mesh's convex hull for contact.

Hollow meshes are cut into convex parts if CoACD is installed (`pip install 'mjtactile[meshes]'`).
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import os
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core import foreign_file
from mjtactile.core.errors import InputError
from mjtactile.sim.scenes.convex_cut import cut
from mjtactile.sim.sensor.feature_size import CONVEX, filled_fraction

SUFFIXES = (".stl", ".obj")
_LARGEST = 1 << 25  # maximum size of a mesh file, bytes
# CoACD's own, relative to the shape's size: a tube in 15 parts in 5 s; at 0.02 52 parts in minutes
_THRESHOLD = 0.05
_ASCII = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)")

Solid = tuple[NDArray[np.float64], NDArray[np.int64]]
"""Vertices (n, 3) m and triangles (m, 3) of vertex indices."""


def load_solid(path: Path) -> Solid:
    """Read a shape in mm from an STL (binary or text) or OBJ file. Raises InputError."""
    spec = mujoco.MjSpec()
    mesh = spec.add_mesh(name="mesh", scale=[1e-3] * 3)
    try:
        content = foreign_file.read_bytes(path, _LARGEST, "a mesh", "mesh")
        is_stl = path.suffix.lower() == ".stl"
        if is_stl and len(corners := _ASCII.findall(content)) >= 12:
            mesh.uservert = np.array(corners, float).ravel()
            mesh.userface = np.arange(len(corners), dtype=np.int32)
        else:
            mesh.file = str(path)
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh")
        model = spec.compile()
    except (ValueError, RuntimeError) as error:
        raise InputError(
            f"not a mesh of {' or '.join(SUFFIXES)}: {' '.join(str(error).split())}",
            source=path,
            field="mesh",
        ) from error
    rotation = np.zeros(9)
    # MuJoCo keeps a mesh in the frame of its inertia
    mujoco.mju_quat2Mat(rotation, model.mesh_quat[0])
    vertices, same = np.unique(
        np.round(model.mesh_vert @ rotation.reshape(3, 3).T + model.mesh_pos[0], 9),
        axis=0,
        return_inverse=True,
    )  # STL repeats each corner for each triangle
    extent = 1e3 * float(np.ptp(vertices, axis=0).max())
    if not 0.01 <= extent <= 1000:
        message = f"is {extent:g} mm wide; a shape of 0.01 to 1000 mm is needed (unit: mm)"
        raise InputError(message, source=path, field="mesh")
    return vertices, same.reshape(-1)[model.mesh_face]


def convex_parts(solid: Solid) -> list[Solid]:
    """Return the convex parts of `solid`, cut by CoACD and cached, or `solid` itself."""
    if filled_fraction(*solid) >= CONVEX:
        return [solid]
    if not _has_coacd():
        return [solid]
    vertices, faces = solid
    key = hashlib.sha256(
        vertices.tobytes() + faces.tobytes() + str(_THRESHOLD).encode()
    ).hexdigest()[:24]
    cached = _cache() / f"{key}.npz"
    with contextlib.suppress(OSError, ValueError, KeyError):
        return _read(cached)
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "mesh.npz"
        target = Path(folder) / "parts.npz"
        np.savez(source, v0=vertices, f0=faces)
        cut(source, target, _THRESHOLD)
        with contextlib.suppress(OSError):  # a cache that cannot be written costs time only
            _keep(cached, target.read_bytes())
        return _read(target)


def add_solid(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, parts: Sequence[Solid]
) -> list[mujoco.MjsGeom]:
    """Add mesh geoms, named `name`, `name`1 …, to a MuJoCo body."""
    geoms = []
    for index, (vertices, faces) in enumerate(parts):
        label = f"{name}{index or ''}"
        mesh = spec.add_mesh(name=label)
        mesh.uservert = vertices.ravel()
        mesh.userface = faces.ravel().astype(np.int32)
        geoms.append(body.add_geom(name=label, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=label))
    return geoms


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mjtactile" / "convex"


def _has_coacd() -> bool:
    try:
        return importlib.util.find_spec("coacd") is not None
    except ValueError:  # an entry of sys.modules without a specification
        return False


def _read(path: Path) -> list[Solid]:
    """Read the parts that `convex_cut.cut` wrote."""
    with np.load(path) as file:
        return [(file[f"v{i}"], file[f"f{i}"]) for i in range(len(file.files) // 2)]


def _keep(path: Path, content: bytes) -> None:
    """Write the parts to a temporary file and move it, for other processes that read it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
        file.write(content)
    Path(file.name).replace(path)
