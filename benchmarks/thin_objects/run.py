"""`mjtactile bench thin-objects`: thin objects and small faces at random positions and speeds.

The reference is the quasi-static membrane on a grid of 81 x 61 nodes (wires: 61 x 46 or 41 x 31);
`bench quasistatic` gives its accuracy.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.thin_objects.press import FACES, THIN_OBJECTS, ThinObject, press
from mjtactile import MembraneSolution, Obstacle, QuasistaticMembrane
from mjtactile.core.errors import InputError, SimulationError
from mjtactile.core.types import Array
from mjtactile.runtime.progress import Progress

PLACES, PLACES_QUICK = 40, 2
SPEEDS = (0.01, 0.03, 0.1)  # speeds of the drive, m/s
_GRID = (81, 61)
_COARSER = ((61, 46), (41, 31))  # for wires, which have no equilibrium on the finest grid
_AROUND = 3e-3  # maximum distance of positions from the center along x and y, m
_SEED = 20
# part of a wire's circumference that a membrane can touch
_ARC = np.radians(np.linspace(-45, 45, 13))
_FLANK = 3e-3  # length of the flanks that extend a wire, m, so that it covers nodes

Notify = Callable[[str], None]


def run(out: Path, *, quick: bool = False, notify: Notify | None = None) -> dict[str, Any]:
    """Return the forces of all indenters at all positions and speeds, and the reference forces."""
    notify = notify or Progress().message
    membranes = [QuasistaticMembrane("dense", grid, 1000.0) for grid in (_GRID, *_COARSER)]
    places = PLACES_QUICK if quick else PLACES
    rows = []
    for name, item in (THIN_OBJECTS | FACES).items():
        notify(f"thin: {name}")
        rng = np.random.default_rng(_SEED)
        for _ in range(places):
            at = rng.uniform(-_AROUND, _AROUND, 2)
            angle = float(rng.uniform(0, np.pi))
            rows.append({"body": name, **_compared(membranes, item, at, angle)})
    return {"places": places, "speeds": list(SPEEDS), "rows": rows}


def _compared(
    membranes: list[QuasistaticMembrane], item: ThinObject, at: Array, turn: float
) -> dict[str, Any]:
    """Return the forces, N, at each speed, the reference force, and the stated error.

    None means that the indenter passed the membrane, with the reason in `stopped`. A refused scene
    ends the benchmark: none should be refused.
    """
    forces: list[float | None] = []
    stopped: list[str] = []
    stated = 0.0
    for speed in SPEEDS:
        try:
            pressed = press(item, (at[0], at[1]), speed, turn=turn)
        except SimulationError as error:
            forces.append(None)
            stopped.append(error.reason)
            continue
        forces.append(pressed.force)
        stated = max(stated, pressed.stated)
    return {
        "at": at.tolist(),
        "turn": turn,
        "forces": forces,
        "quasistatic": _reference(membranes, item, at, turn),
        "stated": stated,
        "stopped": stopped,
    }


def _reference(
    membranes: list[QuasistaticMembrane], item: ThinObject, at: Array, turn: float
) -> float | None:
    """Return the force, N, on the finest quasi-static membrane with an equilibrium."""
    forces = (
        _quasistatic_force(membrane, item, at, turn)
        for membrane in membranes[1 if item.tilt else 0 :]
    )
    return next((force for force in forces if force is not None), None)


def _quasistatic_force(
    membrane: QuasistaticMembrane, item: ThinObject, at: Array, turn: float
) -> float | None:
    """Return the force, N, of the quasi-static membrane on the indenter.

    It is None if there is no equilibrium.
    """
    from scipy.interpolate import RectBivariateSpline

    surface = RectBivariateSpline(membrane.x, membrane.y, membrane.rest.displacements[2])
    height = float(surface.ev(*at)) - item.depth + item.below
    state: MembraneSolution | None = None
    for lift in np.linspace(item.depth, 0.0, 9)[1:]:
        obstacle = _obstacle(item, (at[0], at[1], height + lift), item.rotation(turn))
        try:
            state = membrane.solve(obstacle, state)
        except InputError:  # on the rim, pulled inside out, or through between two nodes
            return None
    return state.force_normal if state is not None and state.converged else None


def _obstacle(item: ThinObject, p_SO: tuple[float, float, float], R_SO: Array) -> Obstacle:
    """Return the indenter as an obstacle of the quasi-static membrane.

    A lying wire is extended by flanks that the membrane does not reach. Otherwise it could pass
    between two nodes undetected.
    """
    if item.kind == "box":
        return QuasistaticMembrane.obstacle("box", item.size, p_SO, R_SO)
    if not item.tilt:
        return QuasistaticMembrane.obstacle("cylinder", item.size[:2], p_SO, R_SO)
    radius, half = item.size[:2]
    half += radius if item.kind == "capsule" else 0.0
    # the wire's axis is its z; its lowest line is at -y, which the tilt about x turns down
    across = radius * np.sin(_ARC)
    down = -radius * np.cos(_ARC)
    flank = _FLANK * np.array([np.cos(_ARC[-1]), np.sin(_ARC[-1])])
    section = [*zip(across, down, strict=True)]
    section += [(x + np.sign(x) * flank[0], y + flank[1]) for x, y in (section[0], section[-1])]
    corners = [(x, y, z) for x, y in section for z in (-half, half)]
    return QuasistaticMembrane.obstacle("mesh", (), p_SO, R_SO, data=corners)


def table(result: dict[str, Any]) -> str:
    """Format the force over that of the quasi-static membrane, by object, in Markdown."""
    speeds = ", ".join(f"{1e3 * s:.0f}" for s in result["speeds"])
    lines = [
        f"{result['places']} positions within {1e3 * _AROUND:.0f} mm of the center, any rotation, "
        f"each at {speeds} mm/s. Ratios: force / force of the quasi-static membrane.",
        "",
        "| object | quasi-static membrane, N | median | 90 % within | worst | speed effect, worst "
        "| stopped | beyond the flagged error |",
        "|---|---|---|---|---|---|---|---|",
    ]
    lines += [_line(result["rows"], name) for name in THIN_OBJECTS | FACES]
    return "\n".join(lines) + "\n"


def _line(rows: list[dict[str, Any]], name: str) -> str:
    selected = [row for row in rows if row["body"] == name]
    stopped = sum(force is None for row in selected for force in row["forces"])
    known = [
        row for row in selected if row["quasistatic"] is not None and None not in row["forces"]
    ]
    if not known:
        return f"| {name} | | | | | | {stopped} | |"
    ratios = np.array([np.array(row["forces"]) / row["quasistatic"] for row in known])
    low, median, high = np.quantile(ratios, [0.05, 0.5, 0.95])
    worst = ratios.flat[np.abs(ratios - 1).argmax()]
    spread = (ratios.max(axis=1) - ratios.min(axis=1)) / ratios.mean(axis=1)
    stated = np.array([row["stated"] for row in known])[:, None]
    beyond = int((np.abs(ratios - 1) > stated).sum())
    membrane = np.mean([row["quasistatic"] for row in known])
    return (
        f"| {name} | {membrane:.3f} | {median:.2f} | {low:.2f} to {high:.2f} | {worst:.2f} | "
        f"{100 * spread.max():.0f} % | {stopped} | {beyond} of {ratios.size} |"
    )
