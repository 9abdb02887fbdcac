"""CoACD in a child process with limited time: it runs for minutes on an open surface, and neither a
signal nor an exception interrupts it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from mjtactile.core import process
from mjtactile.core.errors import InputError

TIME = 60.0
"""Time limit, s; a tube takes 5."""


def cut(source: Path, target: Path, threshold: float) -> None:
    """Cut the mesh in the file `source` into convex parts, written to the file `target`.

    The files are numpy archives: vertices v0, v1 … and faces f0, f1 …

    Raises:
        InputError: The time limit was exceeded, or CoACD failed.
    """
    child = process.start(__name__, source, target, threshold, talk=True)
    try:
        child.communicate(timeout=TIME)
    except subprocess.TimeoutExpired as error:
        message = f"is not cut into convex parts within {TIME:g} s: {_REMEDY}"
        raise InputError(message, field="mesh") from error
    finally:
        process.stop(child)
    if child.returncode or not target.is_file():
        ending = process.how_it_ended(child)
        raise InputError(f"CoACD cannot cut it ({ending}): {_REMEDY}", field="mesh")


_REMEDY = "close its surface, or give convex geoms in an MJCF file"


def main(source: str, target: str, threshold: str) -> None:
    """Run CoACD in this process.

    Args:
        source: File with the mesh.
        target: File for the parts.
        threshold: CoACD's measure of concavity.
    """
    import coacd

    coacd.set_log_level("error")
    with np.load(source) as file:
        vertices, faces = file["v0"], file["f0"]
    size = float(np.ptp(vertices, axis=0).max())
    mesh = coacd.Mesh(vertices / size, faces.astype(np.int32))
    arrays: dict[str, np.ndarray] = {}
    for index, (v, f) in enumerate(coacd.run_coacd(mesh, threshold=float(threshold), seed=0)):
        arrays[f"v{index}"] = size * np.asarray(v)
        arrays[f"f{index}"] = np.asarray(f, np.int64)
    with Path(target).open("wb") as out:
        np.savez(out, **arrays)  # pyright: ignore[reportArgumentType]


if __name__ == "__main__":
    main(*sys.argv[1:])
