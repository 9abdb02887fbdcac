"""Checks of `mjtactile fabricate` on proposed designs.

The quasi-static membrane gives the marker positions of each proposal. The files that are written
pass the full simulation of `fabricate` in addition.
"""

from __future__ import annotations

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.design_study.resolution import ball
from mjtactile.design_study.virtual_bench import VirtualBench
from mjtactile.fabrication.camera_check import plan_camera
from mjtactile.fabrication.housing_layout import Layout
from mjtactile.fabrication.manufacturability import glass_limit
from mjtactile.fabrication.marker_positions import (
    MembraneState,
    indentation_positions,
    indenter_radius,
    press_depth,
    simulate,
    simulate_largest_loads,
)
from mjtactile.fabrication.pressure_loads import PressureLoads
from mjtactile.fabrication.purchased_parts import Hardware

HARDWARE = Hardware()
"""Camera module of the checks: the defaults of `mjtactile fabricate`."""


def check_parts(design: SensorDesign) -> None:
    """Check the limits that require no simulation. Raises InputError."""
    Layout.of(design, HARDWARE, design.name)


def check_camera(stand: VirtualBench) -> None:
    """Check view, focus, motion blur and light on quasi-static states. Raises InputError.

    An indentation without a solution of the quasi-static membrane is left out.

    Args:
        stand: Bench of the design.
    """
    design = stand.design
    depth = press_depth(design, HARDWARE)
    flat = np.zeros_like(stand.membrane.rest.x)
    states = [_state(stand, "flat", flat), _state(stand, "inflated", stand.membrane.rest.x)]
    radius = indenter_radius(design)
    for name, position in indentation_positions(design).items():
        pressed = stand.indent(ball(position, radius), depth)
        if pressed is not None:
            states.append(_state(stand, f"indented at {name}", pressed.state.x))
    plan_camera(design, HARDWARE, states, design.name)


def check_by_simulation(design: SensorDesign) -> None:
    """Check the design as `mjtactile fabricate` does. Raises InputError.

    Args:
        design: The sensor.
    """
    check_parts(design)
    states = simulate(design, HARDWARE, design.name, lambda _: None)
    plan_camera(design, HARDWARE, states, design.name)
    highest = PressureLoads.of(design, states, simulate_largest_loads(design)).highest
    glass_limit(design, highest.gauge_pressure, highest.name).check(design.name)


def _state(stand: VirtualBench, name: str, x: Array) -> MembraneState:
    return MembraneState(name, *stand.poses(x), stand.design.membrane.pre_stretch, 0.0)
