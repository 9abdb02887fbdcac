"""`mjtactile bench quasistatic`: the quasi-static membrane against an independent solver and
against itself, and its computing time.

References (membrane_reference.json) come from an independent solver, same rubber and gas. No
parameter of the quasi-static membrane was chosen on them. That solver's square faces are sets of
nodes, 0.5 mm apart, so that their edges lie on lines of nodes. Their forces agree within 0.6 % on
41 x 31 and 121 x 91 nodes. Its discs are sets of nodes as well, with steps of 0.5 mm along their
edge. Their size is that of their convex hull.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import quasistatic_discretization, quasistatic_times
from mjtactile import MembraneSolution, Obstacle, QuasistaticMembrane, load_sensor
from mjtactile.core.types import Array
from mjtactile.report.figures import new_figure
from mjtactile.runtime.progress import Progress

GRIDS = ((21, 16), (41, 31))
TIMED = (*GRIDS, (61, 46))
PLACED = (*GRIDS, (81, 61))  # the last shows the part due to the curvature of the bulge
USUAL = {"thickness_mm": 0.3, "pre_stretch": 1.05, "rest_Pa": 1000.0}
OTHER = "paper16"
"""Sensor with the membrane, frame and gas of `dense`, to which the same references apply."""
PLACES, PLACES_QUICK = 12, 2
_TIMES = {
    "step of 0.05 mm": "step_us",
    "the same without the trend of earlier steps": "alone_us",
    "six derivatives": "derivatives_us",
    "six derivatives with respect to the pose": "by_pose_us",
}
_MARKERS = np.stack(
    np.meshgrid(np.linspace(-0.016, 0.016, 9), np.linspace(-0.012, 0.012, 9), indexing="ij"), -1
).reshape(-1, 2)

Notify = Callable[[str], None]


def run(out: Path, *, quick: bool = False, notify: Notify | None = None) -> dict[str, Any]:
    """Measure errors against the references, scatter over positions, and times.

    It plots `quasistatic.png` in `out`.
    """
    notify = notify or Progress().message
    path = Path(__file__).with_name("membrane_reference.json")
    references = json.loads(path.read_text(encoding="utf-8"))
    cases = references["cases"]
    cases = cases[::20] if quick else cases
    rows = []
    for grid in GRIDS:
        notify(f"quasi-static membrane: references, {grid[0]} x {grid[1]}")
        rows += [{"grid": list(grid), **_against(case, grid)} for case in cases]
        other = [case for case in cases if _is_usual(case)]
        rows += [
            {"grid": list(grid), "sensor": OTHER, **_against(case, grid, OTHER)} for case in other
        ]
    sticking = [
        {"grid": list(grid), **row} for grid in GRIDS for row in _sticking(grid, references)
    ]
    notify("quasi-static membrane: positions and times")
    places = [
        {"grid": list(grid), **_scatter(grid, PLACES_QUICK if quick else PLACES)} for grid in PLACED
    ]
    narrow = quasistatic_discretization.run(GRIDS, quick)
    times = [quasistatic_times.times(grid, quick) for grid in TIMED]
    _plot(out / "quasistatic.png", references["profiles"])
    found = {"rows": rows, "sticking": sticking, "places": places}
    return found | {"narrow": narrow, "times": times}


def _is_usual(case: dict[str, Any]) -> bool:
    """Return True if a case has the membrane and the gas of the sensor files."""
    return all(case[key] == value for key, value in USUAL.items())


# -- against the references ------------------------------------------------------------------------


def _membrane(
    case: dict[str, Any], grid: tuple[int, int], sensor: str = "dense"
) -> QuasistaticMembrane:
    """Return the quasi-static membrane of a case in a sensor; it is cached."""
    return _made(case["thickness_mm"], case["pre_stretch"], case["rest_Pa"], grid, sensor)


@cache
def _made(
    thickness_mm: float, pre_stretch: float, rest: float, grid: tuple[int, int], sensor: str
) -> QuasistaticMembrane:
    design = load_sensor(sensor)
    changed = {"thickness": 1e-3 * thickness_mm, "pre_stretch": pre_stretch}
    return QuasistaticMembrane(
        replace(design, membrane=replace(design.membrane, **changed)), grid, rest
    )


def _obstacle_of(quasistatic: QuasistaticMembrane, case: dict[str, Any]) -> Obstacle:
    """Return the obstacle of a case.

    The reference's obstacles touch the membrane's midsurface; here they touch its outer face.
    """
    off = quasistatic.design.membrane.thickness / 2
    at = [1e-3 * value for value in case["at_mm"]]
    size = [1e-3 * value for value in case["size_mm"]]
    height = 1e-3 * case["height_mm"]
    if case["kind"] == "ball":
        return quasistatic.obstacle("sphere", (size[0] - off,), (*at, height))
    if case["kind"] == "disc":
        return quasistatic.obstacle("cylinder", (*size, 0.01), (*at, height + off + 0.01))
    return quasistatic.obstacle("box", (*size, 0.01), (*at, height + off + 0.01))


def _against(case: dict[str, Any], grid: tuple[int, int], sensor: str = "dense") -> dict[str, Any]:
    quasistatic = _membrane(case, grid, sensor)
    state = quasistatic.solve(_obstacle_of(quasistatic, case))
    row = {key: case[key] for key in case if key != "markers_um"}
    row["converged"] = bool(state.converged)
    row["force_error"] = state.force_normal / case["force_N"] - 1
    row["pressure_error"] = state.gauge_pressure / case["pressure_Pa"] - 1
    if "markers_um" in case:
        off = _markers(quasistatic, state) - 1e-6 * np.array(case["markers_um"])
        row["heights_um"] = 1e6 * float(np.sqrt(np.mean(off[:, 2] ** 2)))
        row["plane_um"] = 1e6 * float(np.sqrt(np.mean((off[:, :2] ** 2).sum(axis=1))))
    return row


def _markers(quasistatic: QuasistaticMembrane, state: MembraneSolution) -> Array:
    """Interpolate the positions (81, 3), m, of markers on the membrane by cubic splines."""
    from scipy.interpolate import RectBivariateSpline

    fields = (
        RectBivariateSpline(quasistatic.x, quasistatic.y, field) for field in state.displacements
    )
    moved = np.stack([field.ev(_MARKERS[:, 0], _MARKERS[:, 1]) for field in fields], axis=1)
    return np.column_stack([_MARKERS, np.zeros(len(_MARKERS))]) + moved


def _sticking(grid: tuple[int, int], references: dict[str, Any]) -> Iterator[dict[str, float]]:
    """Yield the relative stiffness error of a sticking patch along x and y."""
    quasistatic = QuasistaticMembrane("dense", grid, 1000.0)
    for case in references["sticking"]:
        radius = 1e-3 * case["radius_mm"] - quasistatic.design.membrane.thickness / 2
        ball = quasistatic.obstacle("sphere", (radius,), (0, 0, 1e-3 * case["height_mm"]))
        patch = quasistatic.patches(quasistatic.solve(ball))[0]
        for axis, name in enumerate(("along", "across")):
            yield {"stiffness_error": patch.stiffness[axis, axis] / case[f"{name}_N_per_m"] - 1}


# -- against itself --------------------------------------------------------------------------------


def _obstacles(quasistatic: QuasistaticMembrane, at: Array) -> Iterator[tuple[str, list[Obstacle]]]:
    """Yield obstacles without a reference solution.

    Their force must not depend on the node positions, except for local differences of the
    membrane.
    """
    lying = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    x, y = at
    yield "blade 0.4 x 12 mm", [quasistatic.obstacle("box", (2e-4, 6e-3, 0.01), (x, y, 0.0102))]
    yield "rod 4 mm, lying", [quasistatic.obstacle("capsule", (2e-3, 4e-3), (x, y, 3.2e-3), lying)]
    yield "disc 10 mm", [quasistatic.obstacle("cylinder", (5e-3, 0.01), (x, y, 0.0117))]
    yield "square 12 mm", [quasistatic.obstacle("box", (6e-3, 6e-3, 0.01), (x, y, 0.0117))]
    yield "wedge", [quasistatic.obstacle("wedge", (5e-3, 3e-3, 5e-3), (x, y, 1e-3))]
    yield "cone", [quasistatic.obstacle("cone", (6e-3, 6e-3), (x, y, 1e-3))]
    c, s = np.cos(0.3), np.sin(0.3)
    tilt = np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])
    yield (
        "cube 8 mm, tilted",
        [quasistatic.obstacle("box", (4e-3, 4e-3, 4e-3), (x, y, 6.2e-3), tilt)],
    )
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    yield (
        "blade, turned by 17 degrees",
        [quasistatic.obstacle("box", (2e-4, 6e-3, 0.01), (x, y, 0.0102), rotation)],
    )
    two = [quasistatic.obstacle("sphere", (4e-3,), (x + off, y, 5.5e-3)) for off in (-5e-3, 5e-3)]
    yield "two balls", two


def _scatter(grid: tuple[int, int], count: int) -> dict[str, Any]:
    """Return mean and spread, (max - min) / mean, of forces over `count` positions within 1 mm."""
    quasistatic = QuasistaticMembrane("dense", grid, 1000.0)
    places = np.random.default_rng(4).uniform(-1e-3, 1e-3, (count, 2))
    forces: dict[str, list[float]] = {}
    for at in places:
        for name, obstacles in _obstacles(quasistatic, at):
            found = quasistatic.solve_batch([obstacles])[0].force_normal  # NaN: no solution
            forces.setdefault(name, []).append(found)
    return {name: _summary(np.array(values)) for name, values in forces.items()}


def _summary(forces: Array) -> dict[str, float]:
    found = forces[np.isfinite(forces)]
    mean = float(np.mean(found)) if len(found) else float("nan")
    spread = float(np.ptp(found)) / mean if len(found) else float("nan")
    return {"force_N": mean, "spread": spread, "lost": len(forces) - len(found)}


# -- figure and table ------------------------------------------------------------------------------


def _plot(path: Path, cases: list[dict[str, Any]]) -> None:
    """Plot the membrane from above with its contact, and below a section.

    The section shows it next to the full membrane and the obstacle. A missing matplotlib is
    reported on stderr.
    """
    if (figure := new_figure(path.name, (12, 7.5), dpi=80)) is None:
        return
    axes = figure.subplots(2, 3, height_ratios=(1.1, 1))
    for column, case in enumerate(cases):
        quasistatic = _membrane(case, GRIDS[1])
        state = quasistatic.solve(_obstacle_of(quasistatic, case))
        above, cut = axes[0, column], axes[1, column]
        shown = above.contourf(1e3 * quasistatic.x, 1e3 * quasistatic.y, 1e3 * state.heights.T, 16)
        i, j = np.nonzero(state.contact_forces > 0)
        above.plot(1e3 * quasistatic.x[i], 1e3 * quasistatic.y[j], ".", color="black", markersize=3)
        above.set_aspect("equal")
        above.set_title(case["name"])
        figure.colorbar(shown, ax=above, label="membrane height, mm", orientation="horizontal")
        x = np.linspace(-0.02, 0.02, 801)
        body = 1e3 * quasistatic.obstacle_heights(
            _obstacle_of(quasistatic, case), np.column_stack([x, 0 * x])
        )
        top = 3.3
        cut.fill_between(1e3 * x, body, top, where=body < top, color="0.85", label="object")
        full = 1e-3 * np.array(case["profile_um"])
        cut.plot(full[:, 0], full[:, 1], color="tab:orange", linewidth=5, label="full membrane")
        row = len(quasistatic.y) // 2
        moved, _, z = (1e3 * field[:, row] for field in state.displacements)
        cut.plot(
            1e3 * quasistatic.x + moved,
            z,
            ".-",
            color="black",
            linewidth=1,
            label="quasi-static, 41 x 31",
        )
        cut.set_title(
            f"quasi-static {state.force_normal:.3f} N, full membrane {case['force_N']:.3f} N"
        )
        cut.set_xlabel("x, mm")
        cut.set_ylabel("height, mm")
        cut.set_ylim(-0.2, top)
    axes[1, 0].legend(loc="upper left", fontsize=8)
    figure.savefig(path)


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")


def _line(name: str, rows: list[dict[str, Any]], key: str, by: float, worst: bool = True) -> str:
    cells = []
    for grid in GRIDS:
        found = [by * r[key] for r in rows if r["grid"] == list(grid) and key in r]
        maximum = f" ({max(map(abs, found), default=float('nan')):.1f})" if worst else ""
        cells.append(f"{_rms(found):.2f}{maximum}")
    return f"| {name} | {' | '.join(cells)} |"


def _row(values: Iterable[float], form: str) -> str:
    return " | ".join(f"{value:{form}}" for value in values)


def _cell(place: dict[str, float]) -> str:
    lost = f" ({place['lost']} not converged)" if place["lost"] else ""
    return f"{place['force_N']:.3f}, {100 * place['spread']:.1f} %{lost}"


def table(result: dict[str, Any]) -> str:
    """Format errors, scatter and times in Markdown."""
    rows = [r for r in result["rows"] if "sensor" not in r]
    other = [r for r in result["rows"] if "sensor" in r]
    balls, squares, discs = (
        [r for r in rows if _is_usual(r) and r["kind"] == kind]
        for kind in ("ball", "square", "disc")
    )
    thickness, stretch, pressure = ([r for r in rows if r[key] != USUAL[key]] for key in USUAL)
    others = (("0.5 and 3 kPa: force, %", pressure), ("pre-stretch 1.0 and 1.1: force, %", stretch))
    missed = sum(not r["converged"] for r in rows)
    lines = [
        f"{len(rows) // len(GRIDS)} loads compared with an independent membrane solver; {missed} "
        "did not converge.",
        "",
        "| error, rms (worst) | 21 x 16 | 41 x 31 |",
        "|---|---|---|",
        _line(
            "balls of 4-30 mm, 0.5-3 mm deep, four positions: force, %", balls, "force_error", 100
        ),
        _line("the same: gauge pressure, %", balls, "pressure_error", 100),
        _line("squares of 6-14 mm, two positions: force, %", squares, "force_error", 100),
        _line("discs of 5.5-13.5 mm, two positions: force, %", discs, "force_error", 100),
        _line(f"`{OTHER}`, all of these: force, %", other, "force_error", 100),
        _line("half and double thickness: force, %", thickness, "force_error", 100),
        *(_line(name, some, "force_error", 100) for name, some in others if some),
        _line("marker heights, um", balls, "heights_um", 1),
        _line("in-plane marker positions, um", balls, "plane_um", 1),
        _line(
            "sticking contact, dragged: stiffness, %", result["sticking"], "stiffness_error", 100
        ),
    ]
    lines += [
        "",
        "| force, N, and spread over positions | 21 x 16 | 41 x 31 | 81 x 61 |",
        "|---|---|---|---|",
    ]
    for name in result["places"][0]:
        if name != "grid":
            cells = " | ".join(_cell(place[name]) for place in result["places"])
            lines.append(f"| {name.replace('turned', 'rotated')} | {cells} |")
    lines += quasistatic_discretization.table(result["narrow"])
    times = result["times"]
    names = " | ".join("{} x {}".format(*t["grid"]) for t in times)
    lines += ["", f"| time | {names} |", "|---" * (len(times) + 1) + "|"]
    for name, key in _TIMES.items():
        lines.append(f"| {name}, us | {' | '.join(f'{t[key]:.0f}' for t in times)} |")
    for size in (1, 64):
        each = (f"{1e6 / t['batch_per_s'][f'{size}, 1']:.0f}" for t in times)
        lines.append(
            f"| batch of {size} in equilibrium, one thread, us each | {' | '.join(each)} |"
        )
    gains = [t["batch_per_s"]["64, 2"] / t["batch_per_s"]["64, 1"] for t in times]
    ceilings = [t["ceiling"] for t in times]
    lines += [
        f"| batch of {quasistatic_times.AT_ONCE}: rate of two threads / one "
        f"| {_row(gains, '.2f')} |",
        f"| rate of two independent processes / one | {_row(ceilings, '.2f')} |",
    ]
    return "\n".join(lines) + "\n"
