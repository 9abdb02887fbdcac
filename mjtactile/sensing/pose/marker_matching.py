"""Assignment of detected circles to marker ids, and choice between their two normals.

Matching uses the lateral position in S. Markers keep their distance from each other, while depth
changes fast under a contact load. At start-up the expected positions are those of the flat
membrane. A common offset (a slightly misaligned camera) is removed first. In a sequence the
expected positions are those of the previous image. Wrong matches are detected because neighboring
markers move together. The displacement of each marker is compared with the median of its neighbors'
displacements.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjtactile.core import optics
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array, CirclePoses, Markers
from mjtactile.kernels import kernel
from mjtactile.sensing.settings import DEFAULTS, IdentitySettings, as_numbers
from mjtactile.sensing.surface.surface import SurfaceFitter

Ids = NDArray[np.int64]


def identify(
    poses: CirclePoses,
    design: SensorDesign,
    expected: ArrayLike | None = None,
    scale: ArrayLike | None = None,
    s: IdentitySettings = DEFAULTS.identity,
    *,
    darkness: Array | None = None,
) -> Markers:
    """Return identified markers in S from circle poses in C and the circles' `darkness` (N,).

    `expected` (M, 3), m, are the expected positions in S, by default those of the flat membrane.
    `scale` (M,) is each marker's true radius divided by the nominal radius used for the poses. The
    apparent depth is proportional to it. Circles are left out if their status is not "ok", or if
    they match no marker. They are also left out if they do not move with their neighbors. Two poses
    of a circle are possible. The kept one has the normal that fits the surface through all
    centers.
    """
    layout = design.markers.p_SM
    p_SM = poses.p_CM + design.camera.p_SC
    p_SM[poses.status != "ok"] = np.nan
    ids = match(p_SM, layout if expected is None else expected, layout, s)
    circle = np.full(len(layout), -1)
    circle[ids[ids >= 0]] = np.flatnonzero(ids >= 0)
    ids = np.flatnonzero(circle >= 0)
    n = len(ids)
    p = np.empty((n, 3))
    normals = np.empty((n, 3))
    cov_p = np.empty((n, 3, 3))
    scales = np.ones(n) if scale is None else np.asarray(scale, dtype=float)[ids]
    both = (poses.p_CM, poses.n_C, poses.p_CM_alt, poses.n_C_alt, poses.cov_p)
    camera = (_camera(design).parameters, design.camera.p_SC)
    operators = _slope_operators(design, (circle >= 0).tobytes(), s.height_weight)
    sizes = (n, len(poses.p_CM))
    results = (p, normals, cov_p)
    kernel("name_circles")(*sizes, circle[ids], *both, scales, *camera, operators, *results)
    return Markers(ids, p, normals, cov_p, None if darkness is None else darkness[circle[ids]])


def match(
    p_SM: ArrayLike, expected: ArrayLike, layout: ArrayLike, s: IdentitySettings = DEFAULTS.identity
) -> Ids:
    """Return marker ids (N,) of circles at `p_SM` (N, 3) m, -1 for no match. `expected` (M, 3) m
    are the expected positions (NaN: unknown, then predicted from the neighbors). `layout` (M, 3) m
    is the flat membrane's layout, which defines the neighbors. Each id is assigned at most once.
    NaN rows of `p_SM` match nothing."""
    found, expected, layout = (np.asarray(p, dtype=float)[:, :2] for p in (p_SM, expected, layout))
    pitch, order = _neighbourhood(layout.tobytes(), s.neighbours)
    ids = np.empty(len(found), np.int64)
    kernel("match_markers")(
        len(found), *order.shape, found, expected, layout, order, pitch, as_numbers(s), ids
    )
    return ids


@lru_cache(maxsize=32)
def _slope_operators(design: SensorDesign, present: bytes, weight: float) -> Array:
    """Return matrices (2, n, n) that map marker heights to surface slopes along x and y.

    The n markers are those present, in order of id. The smooth surface is fitted to the heights,
    whose weight is `weight` 1/m^2. The surface is a function of the *flat* membrane's coordinates,
    so that its design matrix stays constant. This neglects the lateral stretch, which changes the
    size of a slope but not its direction.
    """
    fitter = SurfaceFitter(design)
    x, y = design.markers.p_SM[np.frombuffer(present, bool), :2].T
    B = fitter.rows(x, y)
    gain = np.linalg.solve(B.T @ B * weight + fitter.prior, B.T * weight)
    return np.stack([fitter.rows(x, y, 1, 0) @ gain, fitter.rows(x, y, 0, 1) @ gain])


@lru_cache(maxsize=8)
def _neighbourhood(layout: bytes, neighbours: int) -> tuple[float, Ids]:
    """Return the minimum distance of two markers, m, and the nearest others (M, k) of each."""
    xy = np.frombuffer(layout).reshape(-1, 2)
    distance = np.linalg.norm(xy[:, None] - xy, axis=2)
    np.fill_diagonal(distance, np.inf)
    order = np.argsort(distance, axis=1, kind="stable")
    return float(distance.min()), order[:, : min(3 * neighbours, len(xy) - 1)]


@lru_cache(maxsize=8)
def _camera(design: SensorDesign) -> optics.Camera:
    return optics.Camera.from_design(design.camera, design.glass)
