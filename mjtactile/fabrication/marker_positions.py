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
_PRESS = 0.004
_SHARE = 0.25
# maximum offset of the ball's center plus its radius, as a fraction of the frame's side
_REACH = 0.45


@dataclass(frozen=True, eq=False)
class MembraneState:
    """Marker centers (N, 3), m, and outward normals (N, 3) in S.

    `name` describes the state; `stretch` is the largest stretch of the membrane.
    """

    name: str
    p_SM: Array
    n_S: Array
    stretch: float
    height: float


def growth(design: SensorDesign, states: Sequence[MembraneState]) -> float:
    """Return the largest mean growth of the distances between neighboring markers over the states.

    Elastic markers grow by this ratio.
    """
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
    return min(
        _PRESS, _SHARE * design.chamber.depth, _SHARE * min(design.frame.length, design.frame.width)
    )


PLACES = {"the middle": (0, 0), "the +x edge": (1, 0), "the +y edge": (0, 1), "a corner": (1, 1)}
"""Indentation positions, as fractions of the distance from the center to close to the frame."""


def simulate(
    design: SensorDesign,
    hardware: Hardware,
    source: str,
    say: Callable[[str], None],
    places: Mapping[str, tuple[int, int]] = PLACES,
) -> list[MembraneState]:
    """Compute all states.

    Raises InputError if the membrane does not withstand the supply's pressure, or touches the
    glass.
    """
    supply = design.chamber.supply_gauge
    depth = press_depth(design, hardware)
    frame = design.frame
    flat = MembraneState(
        "flat",
        design.markers.p_SM,
        np.tile([0.0, 0, 1], (design.markers.count, 1)),
        design.membrane.pre_stretch,
        0.0,
    )
    if (
        supply > 0
        and np.isnan(analytical_solutions.bulge_height(design, supply))
        and not np.isnan(analytical_solutions.bulge_height(design, 1.0))
    ):
        Limit(
            "chamber.supply_pressure_kPa",
            1e-3 * supply,
            "exceeds the stability limit of this membrane",
            high=1e-3 * _pressure_limit(design),
        ).check(source)
    ball = min(_BALL, 0.25 * min(frame.length, frame.width))
    far = [max(_REACH * side - ball, 0.0) for side in (frame.length, frame.width)]
    states = [flat]
    try:
        for name, (along_x, along_y) in places.items():
            world = PressWorld(
                design, Indenter("sphere", ball), at=(along_x * far[0], along_y * far[1])
            )
            for pressure in dict.fromkeys((0.0, supply)):
                world.inflate(pressure, seal=True)
                if name == "the middle" and pressure:
                    states.append(_state(world, f"inflated to {1e-3 * pressure:g} kPa"))
                world.press(depth)
                states.append(
                    _state(
                        world,
                        f"indented by {1e3 * depth:.2g} mm at {name}, filled at "
                        f"{1e-3 * pressure:g} kPa",
                    )
                )
            say(f"pressed at {name}")
    except SimulationError as error:
        raise InputError(
            f"the membrane fails at {1e-3 * supply:g} kPa and an indentation of "
            f"{1e3 * depth:.2g} mm: {error.reason}",
            source=source,
            field="chamber.supply_pressure_kPa",
        ) from error
    return states


def _state(world: PressWorld, name: str) -> MembraneState:
    sensor = world.sensors[0]
    return MembraneState(
        name, *world.marker_poses(0), sensor.stretch_and_area()[0], sensor.height_at(0.0, 0.0)
    )


def _pressure_limit(design: SensorDesign) -> float:
    """The largest gauge pressure, Pa, that the closed form has a height for."""
    low = 1.0
    high = design.chamber.supply_gauge
    for _ in range(40):
        middle = (low + high) / 2
        if np.isnan(analytical_solutions.bulge_height(design, middle)):
            high = middle
        else:
            low = middle
    return low
