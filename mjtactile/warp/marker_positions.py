"""Markers of a sensor for the device: the spline of `MarkerInterpolator`."""

from __future__ import annotations

from mjtactile.core.types import Array
from mjtactile.quasistatic.membrane import QuasistaticMembrane
from mjtactile.sim.sensor.mesh import MarkerInterpolator, make_mesh, onto_mesh


def weights_of(membrane: QuasistaticMembrane) -> tuple[Array, Array]:
    """Return positions (M, 3), m, on the flat membrane, and displacements per node (M, N)."""
    design = membrane.design
    frame = design.frame
    mesh = make_mesh(frame.length, frame.width, *membrane.grid, outline=frame.outline)
    weights = MarkerInterpolator(mesh, design.markers.p_SM).weights
    by_node = onto_mesh(membrane, mesh)
    return weights @ mesh.p_SV, weights if by_node is None else weights @ by_node
