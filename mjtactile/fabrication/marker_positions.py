"""Simulated marker positions in use: flat, inflated, and indented at center, edges and a corner."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mjtactile.core import analytical_solutions
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError, SimulationError
from mjtactile.core.types import Array
from mjtactile.fabrication.manufacturability import Limit
from mjtactile.fabrication.purchased_parts import Hardware
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

_BALL = 0.008  # indenter radius, m; limited to a quarter of the frame's shorter side
# indentation depth, m, and its limit as a fraction of the chamber's depth and of the shorter side
_DEPTH = 0.004
_DEPTH_FRACTION = 0.25
_REACH = 0.45  # maximum offset of the ball's center plus its radius, as a fraction of the side


@dataclass(frozen=True, eq=False)
class MembraneState:
    """Marker centers (N, 3), m, and outward normals (N, 3) in S; the membrane's largest stretch."""

    name: str
    p_SM: Array
    n_S: Array
    stretch: float
    height: float


def growth(design: SensorDesign, states: Sequence[MembraneState]) -> float:
    """Return the largest mean growth of marker distances, by which elastic markers grow, too."""
    markers = design.markers
    flat = markers.p_SM[:, :2]
    pairs = [
        np.nonzero(np.abs(flat[None] - flat[:, None] - step).max(axis=2) < 1e-9)
        for step in ((markers.pitch_x, 0.0), (0.0, markers.pitch_y))
    ]
    found = []
    for state in states:
        along, across = (
            np.linalg.norm(state.p_SM[b] - state.p_SM[a], axis=1).mean() for a, b in pairs
        )
        found.append((along / markers.pitch_x + across / markers.pitch_y) / 2 - 1)
    return float(max(found))


def press_depth(design: SensorDesign, hardware: Hardware) -> float:
    """Return the largest indentation depth, m."""
    if hardware.press is not None:
        return 1e-3 * hardware.press
    shortest = min(design.chamber.depth, design.frame.length, design.frame.width)
    return min(_DEPTH, _DEPTH_FRACTION * shortest)


_SUPPLY = "chamber.supply_pressure_kPa"
PLACES = {"the middle": (0, 0), "the +x edge": (1, 0), "the +y edge": (0, 1), "a corner": (1, 1)}
"""Indentation positions, as fractions of the distance from the center to close to the frame."""


def simulate(
    design: SensorDesign,
    hardware: Hardware,
    source: str,
    say: Callable[[str], None],
    places: Mapping[str, tuple[int, int]] = PLACES,
) -> list[MembraneState]:
    """Compute all states. Raises InputError if the membrane fails or touches the glass."""
    supply = design.chamber.supply_gauge
    depth = press_depth(design, hardware)
    sides = np.array([design.frame.length, design.frame.width])
    markers = design.markers
    normals = np.tile([0.0, 0, 1], (markers.count, 1))
    states = [MembraneState("flat", markers.p_SM, normals, design.membrane.pre_stretch, 0.0)]
    if supply > 0 and _is_unstable(design, supply) and not _is_unstable(design, 1.0):
        why = "exceeds the stability limit of this membrane"
        Limit(_SUPPLY, 1e-3 * supply, why, high=1e-3 * _pressure_limit(design)).check(source)
    ball = float(min(_BALL, 0.25 * sides.min()))
    far = np.maximum(_REACH * sides - ball, 0.0)
    try:
        for name, direction in places.items():
            x, y = (far * direction).tolist()
            world = PressWorld(design, Indenter("sphere", ball), at=(x, y))
            for pressure in dict.fromkeys((0.0, supply)):
                kpa = f"{1e-3 * pressure:g} kPa"
                world.inflate(pressure, seal=True)
                if name == "the middle" and pressure:
                    states.append(_state(world, f"inflated to {kpa}"))
                world.press(depth)
                load = f"indented by {1e3 * depth:.2g} mm at {name}, filled at {kpa}"
                states.append(_state(world, load))
            say(f"pressed at {name}")
    except SimulationError as error:
        raise InputError(
            f"the membrane fails at {1e-3 * supply:g} kPa and an indentation of "
            f"{1e3 * depth:.2g} mm: {error.reason}",
            source=source,
            field=_SUPPLY,
        ) from error
    return states


def _state(world: PressWorld, name: str) -> MembraneState:
    sensor = world.sensors[0]
    return MembraneState(
        name, *world.marker_poses(0), sensor.stretch_and_area()[0], sensor.height_at(0.0, 0.0)
    )


def _is_unstable(design: SensorDesign, pressure: float) -> bool:
    return bool(np.isnan(analytical_solutions.bulge_height(design, pressure)))


def _pressure_limit(design: SensorDesign) -> float:
    """The largest gauge pressure, Pa, that the closed form has a height for."""
    low = 1.0
    high = design.chamber.supply_gauge
    for _ in range(40):
        middle = (low + high) / 2
        if _is_unstable(design, middle):
            high = middle
        else:
            low = middle
    return low
