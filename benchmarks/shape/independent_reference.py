"""Balls on an independent solver's membrane (membrane_reference.json), with camera noise on the
markers.

The simulation of this package is not involved. That membrane is frictionless, and obstacles touch
its midsurface. The effective ball radius is thus that of the indenter minus half the membrane
thickness, and the force has no friction component.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

import benchmarks
from mjtactile import QuasistaticMembrane, SensingPipeline, load_sensor
from mjtactile.core.types import Array, Markers
from mjtactile.sensing.settings import DEFAULTS

_NOISE = np.array([3.4e-6, 3.4e-6, 19e-6])  # marker noise of one image of `dense`, m
_GRID = np.stack(
    np.meshgrid(np.linspace(-0.016, 0.016, 9), np.linspace(-0.012, 0.012, 9), indexing="ij"), -1
).reshape(-1, 2)
_QUASISTATIC = (41, 31)


def rows() -> list[dict[str, Any]]:
    """Estimate the shape of each of the reference's balls.

    Returns:
        One row per ball.
    """
    design = load_sensor("dense")
    pipeline = SensingPipeline(design)
    quasistatic = QuasistaticMembrane(design, _QUASISTATIC)
    order = [int(np.abs(_GRID - at[:2]).sum(axis=1).argmin()) for at in design.markers.p_SM]
    state = pipeline.load_rest_reference(
        pipeline.initial_state(), _seen(_at_rest(quasistatic)[order]), quasistatic.gauge_pressure
    )
    finder = pipeline.make_shape_estimator(state)
    path = Path(benchmarks.__path__[0]) / "membrane_reference.json"
    found = []
    for seed, case in enumerate(json.loads(path.read_text(encoding="utf-8"))["cases"]):
        if "markers_um" not in case:
            continue
        places = 1e-6 * np.array(case["markers_um"])[order]
        markers = _seen(places + _NOISE * np.random.default_rng(seed).standard_normal((81, 3)))
        touch, _ = pipeline.estimate_touch(state, markers, pipeline.fitter.fit(markers), 0.0)
        shape = pipeline.estimate_contact_shape(state, [touch], finder)
        found.append(
            {
                "kind": shape.kind,
                "radius_mm": 1e3 * shape.radius,
                "radius_true_mm": case["size_mm"][0] - 0.5e3 * design.membrane.thickness,
                "force_N": shape.force_normal / DEFAULTS.contact_shape.friction,
                "force_nodal_N": touch.force_normal,
                "force_true_N": case["force_N"],
                "place_off_mm": float(np.hypot(*(1e3 * shape.p_SO[:2] - case["at_mm"]))),
            }
        )
    return found


def _at_rest(quasistatic: QuasistaticMembrane) -> Array:
    """Return the positions (81, 3), m, of the markers on the membrane at rest."""
    from scipy.interpolate import RectBivariateSpline

    fields = (
        RectBivariateSpline(quasistatic.x, quasistatic.y, field)
        for field in quasistatic.rest.displacements
    )
    moved = np.column_stack([field.ev(_GRID[:, 0], _GRID[:, 1]) for field in fields])
    return moved + np.column_stack([_GRID, np.zeros(len(_GRID))])


def _seen(places: Array) -> Markers:
    count = len(places)
    cov = np.tile(np.diag(_NOISE**2), (count, 1, 1))
    return Markers(np.arange(count), places, np.tile([0.0, 0.0, 1.0], (count, 1)), cov)
