"""Size of an explored object, its uncertainty, and the information gain of a touch about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from mjtactile.core.types import Array
from mjtactile.explore.next_best_touch import Mesh
from mjtactile.explore.surface_fusion import shares
from mjtactile.explore.surface_patch import Patch
from mjtactile.explore.surface_posterior import ALIKE, SurfacePosterior

_END = 5e-4  # distance from the outermost point that counts as an end, m
_FACING = 0.8  # cosine of an end's normal with the axis
_SAMPLES = 24  # sample positions per end
_OBSERVED_SD = 5e-5  # standard deviation of a touch, m
_BEYOND = 0.15  # standard deviation of an end per distance from the touched points, beyond `_NEAR`
_NEAR = 5e-3  # radius of a touch, m
_UNEXPLAINED = 0.4  # standard deviation of the ends, as a fraction of the residual field's
_RIVAL = 0.02  # minimum probability of a relevant rival surface


@dataclass(frozen=True, eq=False)
class Sizes:
    """Extents along the surface's principal axes, the largest first. `mean` (3,), m, and `sd` (3,),
    m, cover the uncertainty of surface and shape model. `interval` (3, 2), m, is the 68 % interval;
    it contains the extent of the touched points."""

    mean: Array
    sd: Array
    interval: Array


def principal_sizes(mesh: Mesh) -> tuple[Array, Array]:
    """Return the extents (3,), m, of a surface along its principal axes, the largest first, and
    these axes as columns (3, 3)."""
    weights = mesh.areas()
    centered = mesh.vertices - np.average(mesh.vertices, axis=0, weights=weights)
    axes = np.linalg.eigh((centered * weights[:, None]).T @ centered)[1][:, ::-1]
    return np.ptp(centered @ axes, axis=0), axes


def sizes(
    meshes: Sequence[Mesh], surfaces: Sequence[SurfacePosterior], patches: Sequence[Patch]
) -> Sizes:
    """Estimate the sizes of the object from the meshes of the most likely surface and of its
    relevant rivals, and from all surfaces, the most likely first."""
    mean, axes = principal_sizes(meshes[0])
    fraction = shares(surfaces)[: len(meshes)]
    fraction = fraction / fraction.sum()
    touched = np.concatenate([patch.points for patch in patches]) if patches else np.zeros((0, 3))
    variance = np.zeros(3)
    for weight, mesh, surface in zip(fraction, meshes, surfaces, strict=False):
        other = np.ptp(mesh.vertices @ axes, axis=0)
        variances = [_variance(surface, _ends(mesh, axis), touched) for axis in axes.T]
        variance += weight * (np.array(variances) + (other - mean) ** 2)
    sd = np.sqrt(variance)
    high = mean + sd
    if len(touched):
        high = np.maximum(high, np.ptp(touched @ axes, axis=0))
    return Sizes(mean, sd, np.column_stack([mean - sd, high]))


def rivals(surfaces: Sequence[SurfacePosterior]) -> list[SurfacePosterior]:
    """Return the surfaces with a relevant probability, in order."""
    return [
        each for each, fraction in zip(surfaces, shares(surfaces), strict=True) if fraction > _RIVAL
    ]


def size_information_gain(mesh: Mesh, surface: SurfacePosterior) -> Array:
    """Return the information gain of a touch at each vertex about the three sizes, (V,) m."""
    _, axes = principal_sizes(mesh)
    variance = mesh.sd**2 + _OBSERVED_SD**2
    gain = np.zeros(len(mesh.vertices))
    for axis in axes.T:
        ends = _ends(mesh, axis)
        across = sum(surface.distance_cov(mesh.vertices, end).mean(axis=1) for end in ends)
        gain += across**2 / variance
    return np.sqrt(gain)


def _ends(mesh: Mesh, axis: Array) -> list[Array]:
    """Return the positions (N, 3) m at both ends of a surface along an axis. For a flat end they
    cover its face. For a round end it is the tip."""
    ends = []
    for direction in (axis, -axis):
        along = mesh.vertices @ direction
        outer = along > along.max() - _END
        face = np.flatnonzero(outer & (mesh.normals @ direction > _FACING))
        chosen = face if len(face) else np.array([int(along.argmax())])
        ends.append(mesh.vertices[chosen[:: -(-len(chosen) // _SAMPLES)]])
    return ends


def _variance(surface: SurfacePosterior, ends: Sequence[Array], touched: Array) -> float:
    """Return the variance of the distance between two ends, m^2. It includes shape and field, and
    three model errors. These are ends far from any touch, a poorly fitting shape, and a common
    error of all touches."""
    points = np.concatenate(list(ends))
    weight = np.concatenate([np.full(len(end), 1 / len(end)) for end in ends])
    variance = max(float(weight @ surface.distance_cov(points, points) @ weight), 0.0)
    variance += (2e-3 * ALIKE) ** 2  # the same at either end
    unexplained = _UNEXPLAINED * 1e-3 * surface.field[0]
    if not len(touched):
        return variance + 2 * unexplained**2
    far = [max(float(cdist(end, touched).min()) - _NEAR, 0.0) for end in ends]
    return variance + sum((_BEYOND * distance) ** 2 + unexplained**2 for distance in far)
