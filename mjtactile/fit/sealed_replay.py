"""Replay of a recording with closed valve: its simulated pressures, and their errors.

A replay takes seconds, and the gas fit needs the pressures for many gas parameters. At a given
position of the stage, the volume under the membrane changes in proportion to a small change of the
pressure. Two replays with different amounts of gas determine this compliance. The gas model and the
compliance give the pressures (docs/theory/gas.md, G1 and G4-G6).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.fit.gas import Sealed
from mjtactile.fit.measurements import Evidence
from mjtactile.fit.membrane_fit import DISCRETIZATION, MembraneFit, first_touch
from mjtactile.fit.simulated_holds import finer_mesh, stage_world
from mjtactile.sim.scenes.stage import StageDrive
from mjtactile.sim.sensor.gas import ChamberGas

_MORE_GAS = 0.2  # additional gas volume of the second replay, as a fraction
_CHANGE = 2.0  # change of the pressure by it that determines the compliance, Pa
_ADDED = 50.0  # pressure difference for the compliance at rest, Pa
# sd of the depth, m, whose effect on the pressure is that of the contact's discretization in a
# hold: another mesh changes it by 0.02 to 0.1 mm, not in proportion to the size of the cells
CONTACT_SD = 5e-5
_NEWTON = 5
_SOLVED = 1e-3  # Pa


@dataclass(frozen=True, eq=False)
class Replay:
    """Simulated gauge `pressure` (time,) Pa, and `volume` (time,) m^3 under the membrane."""

    pressure: Array
    volume: Array


def replay(
    design: SensorDesign,
    evidence: Evidence,
    offset: float = 0.0,
    mesh: tuple[int, int] | None = None,
) -> Replay:
    """Simulate a recording with closed valve, at the times of its series.

    Args:
        design: Sensor.
        evidence: Recording.
        offset: Depth of first contact below its mark, m.
        mesh: Vertices of the membrane; None: the default.

    Returns:
        Pressures and volumes.
    """
    stage = evidence.stage
    world = stage_world(design, evidence, mesh)
    sensor = world.sensors[0]
    world.inflate(evidence.rest.pressure, seal=True)
    drive = StageDrive(world, stage.moves if stage else (), offset)
    pressures = []
    volumes = []
    for time in evidence.series.time.tolist():
        drive.advance_to(time)
        pressures.append(sensor.gauge_pressure)
        volumes.append(sensor.volume - design.chamber_volume_flat)
    return Replay(np.array(pressures), np.array(volumes))


@dataclass(frozen=True, eq=False)
class ReplayedRecording:
    """Recording that is replayed with its `offset` of the first contact, m."""

    evidence: Evidence
    offset: float
    mesh: tuple[int, int]

    def replay(self, design: SensorDesign) -> Replay:
        return replay(design, self.evidence, self.offset, self.mesh)

    def compliance(self, design: SensorDesign, base: Replay) -> Array:
        """Return the change of the volume with the pressure, (time,) m^3/Pa.

        Where more gas changes the pressure, it is that of a replay with more gas: a contact that
        sticks makes the membrane softer than a pressure that was there before it. Elsewhere it is
        the compliance at rest.
        """
        more = design.chamber.extra_volume + _MORE_GAS * design.chamber_volume_flat
        other = self.replay(replace(design, chamber=replace(design.chamber, extra_volume=more)))
        pressure = other.pressure - base.pressure
        volume = other.volume - base.volume
        weight = _CHANGE**2
        return (volume * pressure + self._compliance_at_rest(design) * weight) / (
            pressure**2 + weight
        )

    def _compliance_at_rest(self, design: SensorDesign) -> float:
        """Return the compliance without contact, m^3/Pa."""
        world = stage_world(design, self.evidence, self.mesh)
        volumes = []
        for added in (0.0, _ADDED):
            world.inflate(self.evidence.rest.pressure + added, seal=False)
            volumes.append(world.sensors[0].volume)
        return (volumes[1] - volumes[0]) / _ADDED


def linear_model(
    design: SensorDesign, base: Replay, compliance: Array, shift: Array
) -> Callable[[SensorDesign, Sealed], Array]:
    """Return the model of a recording's pressures for sensors with other gas.

    `base` is the replay with `design`, and `shift` (time,) Pa is added to it.
    """

    def solve(sensor: SensorDesign, time: Array) -> Array:
        return _pressures(sensor, time, base, compliance)

    known: list[Array] = []

    def model(sensor: SensorDesign, run: Sealed) -> Array:
        if not known:
            known.append(base.pressure + shift - solve(design, run.time))
        return known[0] + solve(sensor, run.time)

    return model


def _pressures(design: SensorDesign, time: Array, base: Replay, compliance: Array) -> Array:
    """Return the gauge pressures of the closed gas under a membrane of known compliance."""
    gas = ChamberGas(design.chamber)
    flat = design.chamber_volume_flat
    pressure = float(base.pressure[0])
    gas.seal(flat + float(base.volume[0]), pressure)
    pressures = [pressure]
    rows = zip(base.pressure[1:], base.volume[1:], compliance[1:], np.diff(time), strict=True)
    before = pressure
    for there, volume, softness, elapsed in np.array(list(rows)).tolist():
        pressure += there - before
        for _ in range(_NEWTON):
            moved = gas.at(flat + volume + softness * (pressure - there), elapsed)
            slope = 1 + softness * moved.stiffness(elapsed)
            change = (moved.gauge_pressure - pressure) / slope
            pressure += change
            if abs(change) < _SOLVED:
                break
        gas.advance(flat + volume + softness * (pressure - there), elapsed)
        pressures.append(pressure)
        before = there
    return np.array(pressures)


@dataclass(frozen=True, eq=False)
class MembraneErrors:
    """Effect of the membrane fit's errors on the pressures.

    `modes` are independent, each scaled to one sd: an array for each recording, (time,) Pa. `shift`
    is the effect of the found discretization error, an array for each recording.
    """

    modes: list[list[Array]]
    shift: list[Array]


def membrane_errors(
    design: SensorDesign,
    recordings: Sequence[ReplayedRecording],
    base: Sequence[Replay],
    membrane: MembraneFit,
) -> MembraneErrors:
    """Return the effect of modulus, pre-stretch, first contacts and discretization.

    Their errors are correlated: markers that the fit explains by one are not explained by another.
    The modes are the sensitivities times the square root of the joint covariance. Further modes are
    the contact's discretization in each hold.

    Args:
        design: Sensor with the fitted membrane.
        recordings: Replayed recordings.
        base: Their replays with `design`.
        membrane: Result of the membrane fit.

    Returns:
        The modes and the shift.
    """

    def changes(
        changed: SensorDesign, others: Sequence[ReplayedRecording], scale: float = 1.0
    ) -> list[Array]:
        return [
            np.zeros(len(before.pressure))
            if other is recording and changed is design
            else scale * (other.replay(changed).pressure - before.pressure)
            for recording, other, before in zip(recordings, others, base, strict=True)
        ]

    sd = dict(zip(membrane.names, np.sqrt(np.diag(membrane.cov)).tolist(), strict=True))
    effects: dict[str, list[Array]] = {}  # of one sd
    for name in ("young", "pre_stretch"):
        if name in sd:
            value = membrane.values[name] + sd[name]
            changed = replace(design, membrane=replace(design.membrane, **{name: value}))
            effects[name] = changes(changed, recordings)
    for recording in recordings:
        if (name := first_touch(recording.evidence)) in sd:
            deeper = replace(recording, offset=recording.offset + sd[name])
            effects[name] = changes(design, [deeper if r is recording else r for r in recordings])
    nothing = [np.zeros(len(before.pressure)) for before in base]
    shift = nothing
    if DISCRETIZATION in sd:
        finer = [finer_mesh(r.mesh) for r in recordings]
        finest = [replace(r, mesh=mesh) for r, (mesh, _) in zip(recordings, finer, strict=True)]
        whole = changes(design, finest, finer[0][1])
        shift = [membrane.discretization * change for change in whole]
        effects[DISCRETIZATION] = [sd[DISCRETIZATION] * change for change in whole]
    contacts = [
        [
            effects[name][index] * (CONTACT_SD / sd[name]) * during if n == index else none
            for n, none in enumerate(nothing)
        ]
        for index, recording in enumerate(recordings)
        if (name := first_touch(recording.evidence)) in effects
        for during in _holds(recording.evidence)
    ]
    return MembraneErrors([*_independent(effects, membrane), *contacts], shift)


def _independent(effects: Mapping[str, list[Array]], membrane: MembraneFit) -> list[list[Array]]:
    """Return the independent modes of correlated errors with these effects of one sd."""
    if not effects:
        return []
    rows = [membrane.names.index(name) for name in effects]
    scale = np.sqrt(np.diag(membrane.cov))[rows]
    spread, axes = np.linalg.eigh(membrane.cov[np.ix_(rows, rows)] / np.outer(scale, scale))
    roots = axes * np.sqrt(np.maximum(spread, 0.0))
    return [
        [np.tensordot(root, np.array(parts), 1) for parts in zip(*effects.values(), strict=True)]
        for root in roots.T
    ]


def _holds(evidence: Evidence) -> list[Array]:
    """Return 1 from each indentation to the next move, otherwise 0, (time,)."""
    time = evidence.series.time
    moves = evidence.stage.moves if evidence.stage else ()
    ends = [*(move.time for move in moves[1:]), math.inf]
    return [
        ((time >= move.time) & (time < end)).astype(float)
        for move, end in zip(moves, ends, strict=True)
        if move.touches and move.time <= time[-1]
    ]


def can_replay(evidence: Evidence) -> bool:
    """Return True for a recording on a stage: no contact, or known depths without shear.

    The simulated volume has no noise: that of the markers at the start of a recording would shift
    all its pressures. Shear contains little information on the gas and takes long to simulate.
    """
    if evidence.stage is None:
        return False
    return not any(move.is_weight or move.shear for move in evidence.stage.moves)


def touches(evidence: Evidence) -> bool:
    """Return True if the stage of a recording indents the membrane."""
    return any(move.touches for move in evidence.stage.moves) if evidence.stage else False
