"""Images of a membrane computed with the membrane model of the pipeline, without the simulator.

The membrane is flat, in equilibrium, and under a round traction patch that grows and is dragged
along.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from mjtactile.core.design import load_sensor
from mjtactile.core.types import Image
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.force.spline_fem import Gas
from mjtactile.sim.rendering.renderer import Renderer

GAUGE = 1000.0  # gauge pressure, Pa
PLACE = np.array([0.003, -0.002])  # center of the patch, m
RADIUS = 0.005  # radius of the patch, m
LOADS = ((0.0, 0.1), (0.05, 0.4), (0.15, 0.8), (0.0, 0.0))  # shear along x and normal force, N


@dataclass(frozen=True, eq=False)
class Sequence:
    """Images of a sensor, including its references, at 30 Hz."""

    flat: tuple[Image, ...]
    rest: tuple[Image, ...]
    pressed: tuple[Image, ...]


@cache
def sequence(sensor: str = "paper16") -> Sequence:
    """Render the images of a sensor, shipped or from a file: four of each reference, and one for
    each of `LOADS`."""
    design = load_sensor(sensor)
    rubber = InverseMembrane(design).membrane
    view = Renderer(design, seed=1)
    flat = np.zeros((3, rubber.count))
    rest = rubber.equilibrium(Gas(GAUGE))
    gas = rubber.seal(rubber.state(rest), GAUGE)
    states = [rubber.equilibrium(gas, load=_load(rubber, *load), start=rest) for load in LOADS]
    at = np.arange(8) / 30
    return Sequence(
        tuple(_image(design, rubber, view, flat, 0.0) for _ in range(4)),
        tuple(_image(design, rubber, view, rest, 0.0) for _ in range(4)),
        tuple(_image(design, rubber, view, c, t) for c, t in zip(states, at, strict=False)),
    )


def _load(rubber, shear, normal):
    """Return generalised forces (3, n) of a force, N, uniform over a disc."""
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    places = np.concatenate([PLACE + fraction * RADIUS * ring for fraction in (0.3, 0.6, 0.9)])
    fraction = rubber.basis(rubber.parametric(places)).mean(axis=0)
    return np.outer([shear, 0.0, -normal], fraction)


def _image(design, rubber, view, c, time):
    X = design.markers.p_SM
    p = X + rubber.basis(rubber.parametric(X[:, :2])) @ c.T
    step = 1e-5  # difference step, m
    along, across = (
        step * unit + (rubber.basis(rubber.parametric(X[:, :2] + step * unit[:2])) @ c.T) - (p - X)
        for unit in np.eye(3)[:2]
    )
    normal = np.cross(along, across)
    return view.render(p, normal / np.linalg.norm(normal, axis=1)[:, None], time)
