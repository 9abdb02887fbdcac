"""Simulated holds of a recording's moves, at the pressures measured in them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.fit.measurements import Evidence, Hold
from mjtactile.recording.stage_protocol import Move
from mjtactile.sim.attach import default_mesh
from mjtactile.sim.scenes.indentation import Indenter, PressWorld
from mjtactile.sim.scenes.stage import LIFTED

_FINER = 4 / 3  # mesh refinement for the discretization error
_NOWHERE = "sphere:8"
# search for the unknown depth under a weight: first depth, m; iterations; relative force tolerance
_FIRST_DEPTH = 2e-3
_TRIES = 12
_FORCE_TOLERANCE = 0.003
_LARGEST_STEP = 4e-3  # limit of the time step, s
# speed of the simulated moves, m/s; a slower move changes the marker positions by less than 2 um
_SPEED = 0.01
_PRESSURES = 4  # pressures of a move, equally spaced between those of the holds
_DEEPER = 1e-4  # change of the depth from which on the pressure changes during a move, m


@dataclass(frozen=True, eq=False)
class Simulated:
    """Simulated hold.

    It holds the markers (N, 3) m in S, the volume under the membrane, m^3, and the stage force (3,)
    N.
    """

    p_SM: Array
    volume: float
    force: Array


def simulate(
    design: SensorDesign,
    evidence: Evidence,
    offset: float = 0.0,
    mesh: tuple[int, int] | None = None,
) -> tuple[Simulated, ...]:
    """Simulate the rest and the holds of a recording, in order.

    The first touch is `offset` m deeper than its mark.
    """
    stage = evidence.stage
    world = stage_world(design, evidence, mesh)
    pressure = _pressure(design, evidence, evidence.rest)
    world.inflate(pressure, seal=False)
    found = [_read_state(world)]
    known = {id(hold.move): hold for hold in evidence.holds}
    moves = (None, *(stage.moves if stage else ()))
    last = max((i for i, move in enumerate(moves) if id(move) in known), default=-1)
    for move in moves[: last + 1]:
        hold = known.get(id(move))
        if hold is not None:
            pressure = _pressure(design, evidence, hold)
        if move is None:
            world.sensors[0].open_valve(pressure)
            world.settle()
        else:
            _move(world, move, offset, pressure)
        if hold is not None:
            found.append(_read_state(world))
    return tuple(found)


def stage_world(
    design: SensorDesign, evidence: Evidence, mesh: tuple[int, int] | None
) -> PressWorld:
    stage = evidence.stage
    period = 1 / design.camera.rate
    return PressWorld(
        design,
        Indenter.parse(stage.indenter if stage else _NOWHERE),
        at=stage.at if stage else (0.0, 0.0),
        timestep=period / math.ceil(period / _LARGEST_STEP),
        mesh=mesh or default_mesh(design),
    )


def finer_mesh(mesh: tuple[int, int]) -> tuple[tuple[int, int], float]:
    """Return a finer mesh, and the factor of its effect at an infinitely fine one.

    The discretization error is of second order. Both counts stay odd: one vertex is in the center.
    """
    finer = tuple(2 * round(_FINER * (count - 1) / 2) + 1 for count in mesh)
    return (finer[0], finer[1]), 1 / (1 - _FINER**-2)


def _move(world: PressWorld, move: Move, offset: float, pressure: float) -> None:
    """Simulate a move to a hold at a gauge `pressure`, Pa.

    The pressure of a closed chamber rises while the contact grows. A contact that sticks keeps the
    membrane's state of that time, so that the pressure changes with the depth here, too.
    """
    sensor = world.sensors[0]
    before = sensor.gauge_pressure
    depth = move.depth + offset
    touched = max(world.depth, 0.0)
    if move.touches and not move.shear and depth - touched > _DEEPER:
        for part in np.linspace(0.0, 1.0, _PRESSURES + 1)[1:-1].tolist():
            sensor.open_valve(before + part * (pressure - before))
            world.drive(touched + part * (depth - touched), move.shear, _SPEED)
    sensor.open_valve(pressure)
    if not move.touches:
        world.press(LIFTED, 0.0, _SPEED)
    elif move.is_weight:
        _press_with(world, move)
    else:
        world.press(depth, move.shear, _SPEED)


def _press_with(world: PressWorld, move: Move) -> None:
    """Move the stage to the depth at which it exerts the move's force.

    The method is false position between depths with too little and too much force.
    """
    low = 0.0
    high = _FIRST_DEPTH
    too_little = -move.force
    too_much = math.nan
    for _ in range(_TRIES):
        depth = high
        if not math.isnan(too_much):
            depth = low + max(0.1, min(0.9, too_little / (too_little - too_much))) * (high - low)
        world.press(depth, move.shear, _SPEED)
        excess = -float(world.drive_force[2]) - move.force
        if abs(excess) < _FORCE_TOLERANCE * move.force:
            return
        if excess > 0:
            high = depth
            too_much = excess
        else:
            low = depth
            too_little = excess
            if math.isnan(too_much):
                high = min(1.5 * high, 0.9 * world.design.chamber.depth)


def _pressure(design: SensorDesign, evidence: Evidence, hold: Hold) -> float:
    """Return the measured gauge pressure, Pa.

    Without a pressure sensor it is the supply's pressure, which a closed valve does not
    maintain.
    """
    if math.isfinite(hold.pressure):
        return hold.pressure
    if evidence.has_pressure:
        return evidence.rest.pressure
    return design.chamber.supply_gauge


def _read_state(world: PressWorld) -> Simulated:
    sensor = world.sensors[0]
    volume = sensor.volume - sensor.design.chamber_volume_flat
    return Simulated(world.marker_poses(0)[0], volume, world.drive_force)
