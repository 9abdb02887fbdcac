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
from mjtactile.fit.parameter_info import FIT_PRESSURES
from mjtactile.recording.stage_protocol import protocol_indenter, read_moves
from mjtactile.sim.scenes.indentation import Indenter, PressWorld
from mjtactile.sim.sensor.validity_checks import STRETCHED

_BALL = 0.008  # indenter radius, m; limited to a quarter of the frame's shorter side
# indentation depth, m, and its limit as a fraction of the chamber's depth and of the shorter side
_DEPTH = 0.004
_DEPTH_FRACTION = 0.25
_STEPS = 4  # steps of an indentation
SERVO_FORCE = 2.5
"""Largest force of the servo in the bill, N."""
_FORCE_STEP = 5e-4  # depth step of the search for a force, m
_RESERVE = 0.99  # used fraction of an interpolated depth: the contact depends slightly on the steps
_PARTS = 101  # number of tested positions on the way to the center
_DEEPEST_FRACTION = 0.9  # maximum indentation of a protocol, as a fraction of the chamber's depth
_OFFSET_MAX = 0.45  # maximum offset of the ball's center plus its radius, as a fraction of the side


@dataclass(frozen=True, eq=False)
class MembraneState:
    """Marker centers (N, 3), m, and outward normals (N, 3) in S; the membrane's largest stretch,
    its height at the center, m, and the gauge pressure behind it, Pa."""

    name: str
    p_SM: Array
    n_S: Array
    stretch: float
    height: float
    gauge_pressure: float = 0.0


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
POSITIONS = {"the middle": (0, 0), "the +x edge": (1, 0), "the +y edge": (0, 1), "a corner": (1, 1)}
"""Indentation positions, as fractions of the distance from the center to close to the frame."""


def indenter_radius(design: SensorDesign) -> float:
    """Return the radius of the indenting ball, m."""
    return min(_BALL, 0.25 * min(design.frame.length, design.frame.width))


def indentation_positions(
    design: SensorDesign, positions: Mapping[str, tuple[int, int]] = POSITIONS
) -> dict[str, Array]:
    """Return the positions (2,), m in S, of the indentations by their names."""
    sides = np.array([design.frame.length, design.frame.width])
    ball = indenter_radius(design)
    far = np.maximum(_OFFSET_MAX * sides - ball, 0.0)
    return {name: _inward(design, far * np.array(to), ball) for name, to in positions.items()}


def simulate(
    design: SensorDesign,
    hardware: Hardware,
    source: str,
    notify: Callable[[str], None],
    positions: Mapping[str, tuple[int, int]] = POSITIONS,
) -> list[MembraneState]:
    """Compute all states. Raises InputError if the membrane fails, touches the glass, or stretches
    beyond the range of its material law."""
    supply = design.chamber.supply_gauge
    depth = press_depth(design, hardware)
    markers = design.markers
    normals = np.tile([0.0, 0, 1], (markers.count, 1))
    states = [MembraneState("flat", markers.p_SM, normals, design.membrane.pre_stretch, 0.0)]
    if supply > 0 and _is_unstable(design, supply) and not _is_unstable(design, 1.0):
        why = "exceeds the stability limit of this membrane"
        Limit(_SUPPLY, 1e-3 * supply, why, high=1e-3 * _pressure_limit(design)).check(source)
    ball = indenter_radius(design)
    try:
        for name, position in indentation_positions(design, positions).items():
            x, y = position.tolist()
            world = PressWorld(design, Indenter("sphere", ball), at=(x, y))
            for pressure in dict.fromkeys((0.0, supply)):
                kpa = f"{1e-3 * pressure:g} kPa"
                world.inflate(pressure, seal=True)
                if name == "the middle" and pressure:
                    states.append(_state(world, f"inflated to {kpa}"))
                    _check_inflated(design, states[-1], source)
                load = f"indented by {1e3 * depth:.2g} mm at {name}, filled at {kpa}"
                states.append(_indented(world, depth, load))
            notify(f"pressed at {name}")
    except SimulationError as error:
        raise InputError(
            f"the membrane fails at {1e-3 * supply:g} kPa and an indentation of "
            f"{1e3 * depth:.2g} mm: {error.reason}",
            source=source,
            field=_SUPPLY,
        ) from error
    return states


def simulate_largest_loads(
    design: SensorDesign, notify: Callable[[str], None] = lambda _: None
) -> list[MembraneState]:
    """Simulate the largest loads with the valve closed: those of the protocols that `mjtactile fit`
    requires, and the largest force of the servo in the bill.

    Args:
        design: The sensor.
        notify: Called with progress messages.

    Returns:
        The states at the largest depth of each protocol, and the one at the largest force or at the
        largest depth before the glass. A load that the membrane does not carry is left out.
    """
    side = min(design.frame.length, design.frame.width)
    supply = design.chamber.supply_gauge
    loads = (("press", max(FIT_PRESSURES)), ("tap", supply))
    states = []
    for protocol, pressure in loads:
        indenter = protocol_indenter(protocol, side)
        moves = [move for move in read_moves(protocol) if move.touches]
        depth = min(max(move.depth for move in moves), _DEEPEST_FRACTION * design.chamber.depth)
        load_text = f"protocol {protocol} with {indenter}, filled at {1e-3 * pressure:g} kPa"
        notify(load_text)
        try:
            world = PressWorld(design, Indenter.parse(indenter))
            world.inflate(pressure, seal=True)
            states.append(_state(world, f"{load_text}, inflated"))
            world.press(depth)
            states.append(_state(world, load_text))
        except SimulationError:
            continue
    return [*states, *_largest_force(design)]


def _largest_force(design: SensorDesign) -> list[MembraneState]:
    """Return the state at the largest force of the servo, or at the largest depth."""
    world = PressWorld(design, Indenter("sphere", indenter_radius(design)))
    states: list[MembraneState] = []
    try:
        world.inflate(design.chamber.supply_gauge, seal=True)
        deepest = _DEEPEST_FRACTION * design.chamber.depth
        for depth in np.arange(_FORCE_STEP, deepest, _FORCE_STEP).tolist():
            world.press(depth)
            force = -float(world.drive_force[2])
            name = f"indented by {1e3 * depth:.2g} mm at the middle with {force:.2g} N"
            states = [_state(world, name)]
            if force >= SERVO_FORCE:
                break
    except SimulationError:
        pass
    return states


def _inward(design: SensorDesign, position: Array, ball: float) -> Array:
    """Move a position (2,), m, towards the center until the ball lies within the outline."""
    frame = design.frame
    clear = ball + (0.5 - _OFFSET_MAX) * min(frame.length, frame.width)
    parts = np.linspace(1.0, 0.0, _PARTS)
    allowed = frame.inside(parts[:, None] * position) >= clear - 1e-9
    return position if frame.outline is None else position * parts[np.argmax(allowed)]


def _indented(world: PressWorld, depth: float, name: str) -> MembraneState:
    """Press to a depth, m, in steps. Raises InputError at a stretch beyond the material law."""
    before = 0.0
    stretch_before = world.sensors[0].stretch_and_area()[0]
    for step in depth * np.arange(1, _STEPS + 1) / _STEPS:
        world.press(float(step))
        stretch = world.sensors[0].stretch_and_area()[0]
        if stretch > STRETCHED:
            part = max(STRETCHED - stretch_before, 0.0) / (stretch - stretch_before)
            why = (
                f"stretches the membrane to {stretch:.3g} of its free length or more ({name}), "
                f"beyond {STRETCHED:g}, up to which the simulated material law holds"
            )
            Limit(
                "--press-mm",
                1e3 * depth,
                why,
                high=1e3 * (_RESERVE * (before + part * (step - before))),
            ).check("")
        before = float(step)
        stretch_before = stretch
    return _state(world, name)


def _check_inflated(design: SensorDesign, state: MembraneState, source: str) -> None:
    """Raise InputError if the free membrane is stretched beyond the range of its material law."""
    if state.stretch > STRETCHED:
        raise InputError(
            f"{1e-3 * design.chamber.supply_gauge:g} stretches the free membrane to "
            f"{state.stretch:.3g} of its free length; the simulated material law holds to "
            f"{STRETCHED:g}: use a lower pressure or a stiffer membrane",
            source=source,
            field=_SUPPLY,
        )


def _state(world: PressWorld, name: str) -> MembraneState:
    sensor = world.sensors[0]
    return MembraneState(
        name,
        *world.marker_poses(0),
        sensor.stretch_and_area()[0],
        sensor.height_at(0.0, 0.0),
        sensor.gauge_pressure,
    )


def _is_unstable(design: SensorDesign, pressure: float) -> bool:
    return bool(np.isnan(analytical_solutions.bulge_height(design, pressure)))


def _pressure_limit(design: SensorDesign) -> float:
    """Return the largest gauge pressure, Pa, at which the closed form gives a height."""
    low = 1.0
    high = design.chamber.supply_gauge
    for _ in range(40):
        midpoint = (low + high) / 2
        if _is_unstable(design, midpoint):
            high = midpoint
        else:
            low = midpoint
    return low
