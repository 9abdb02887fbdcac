"""`mjtactile bench stability`: run hard cases to the end, check them by physics, and plot the map.

A case is run twice, at its time step and at a quarter of it. Its outcome is

    ok        finite, no warning, settled, energy bounded, penetration bounded, force within 10 % of
              the quarter step's
    flagged   the simulation reported the problem itself, or stopped with a physical reason (the
              glass, sunk in)
    refused   the scene was not built, with the reason
    FAILED    an error occurred without a report
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.scenes.stress_scenes import DropWorld, FreeObject, PinchWorld
from benchmarks.stability.cases import Case, matrix, pruned
from mjtactile.core import platform_support
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError, SimulationError
from mjtactile.core.flags import Cadence
from mjtactile.report.figures import new_figure
from mjtactile.runtime.progress import Progress
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.indentation import Indenter, PressWorld
from mjtactile.sim.scenes.world import World

OUTCOMES = ("ok", "flagged", "refused", "FAILED")
_COLOURS = {"ok": "#4c9f70", "flagged": "#e8b84a", "refused": "#8a94a6", "FAILED": "#c0392b"}
# relative force error; minimum force for it, N
FORCE_ERROR = 0.10
FORCE_FLOOR = 0.005
PENETRATION = 0.10  # limit of the penetration, m per m of indentation
_NUMERICAL = ("not finite", "MuJoCo warned")
_ACCOUNTED = {
    "force": {"penetration", "speed", "unsettled", "small_feature", "sharp_edge", "solver"},
    "settled": {"unsettled", "solver"},
    "penetration": {"penetration", "solver"},
    "energy": {"unsettled", "solver"},
    "weight": {"unsettled", "penetration", "solver"},
}
"""A failed check, and the flags that account for it; a value that is not finite has none."""


def run(
    out: Path,
    quick: bool = False,
    notify: Callable[[str], None] | None = None,
    *,
    resume: bool = False,
) -> dict[str, Any]:
    """Run the matrix in two processes, with `quick` the pruned set.

    It plots `stability.png` in `out`, and returns the JSON object. Every finished case is appended
    to `stability.jsonl`. `resume` keeps those of an interrupted run.

    Every case that ends is appended to `stability.jsonl`; `resume` keeps those that an interrupted
    run left there.
    """
    notify = Progress().message if notify is None else notify
    cases = pruned() if quick else matrix()
    log = out / "stability.jsonl"
    place = {(c.axis, c.label): i for i, c in enumerate(cases)}
    rows = _kept(log, place) if resume else []
    log.write_text("".join(f"{json.dumps(row)}\n" for row in rows), encoding="utf-8")
    done = {(row["axis"], row["label"]) for row in rows}
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with (
        multiprocessing.get_context("spawn").Pool(min(2, platform_support.processors())) as pool,
        log.open("a") as file,
    ):
        for row in pool.imap_unordered(
            evaluate, [c for c in cases if (c.axis, c.label) not in done]
        ):
            rows.append(row)
            print(json.dumps(row), file=file, flush=True)
            if row["outcome"] == "FAILED" or len(rows) % 25 == 0:
                notify(
                    f"{len(rows)}/{len(cases)} {row['axis']}, {row['label']}: {row['outcome']} "
                    f"{row['reason']}"
                )
    rows.sort(key=lambda row: place[row["axis"], row["label"]])
    result = {
        "cases": rows,
        "counts": {o: sum(r["outcome"] == o for r in rows) for o in OUTCOMES},
        "core_s": sum(row["wall_s"] for row in rows),
    }
    _save(out / "stability.png", rows)
    return result


def _kept(log: Path, place: Mapping[tuple[str, str], int]) -> list[dict[str, Any]]:
    """Return the cases of `place` that an earlier run finished; incomplete lines are left out."""
    rows = {}
    for line in log.read_text(encoding="utf-8").splitlines() if log.is_file() else ():
        with contextlib.suppress(ValueError):
            row = json.loads(line)
            rows[row["axis"], row["label"]] = row
    return [row for key, row in rows.items() if key in place]


def evaluate(case: Case) -> dict[str, Any]:
    """Run one case and return its outcome."""
    row: dict[str, Any] = {
        "axis": case.axis,
        "label": case.label,
        "kind": case.kind,
        "reason": "",
        "flags": {},
    }
    row["setting"] = {
        k: v
        for k, v in asdict(case).items()
        if v != getattr(_DEFAULT, k) and k not in ("axis", "label", "kind")
    }
    started = time.perf_counter()
    try:
        row |= _compare(case)
    except InputError as error:
        row |= {"outcome": "refused", "reason": str(error)}
    except SimulationError as error:
        numerical = any(word in error.reason for word in _NUMERICAL)
        row |= {"outcome": "FAILED" if numerical else "flagged", "reason": error.reason}
    row["wall_s"] = time.perf_counter() - started
    return row


_DEFAULT = Case("", "")


def _compare(case: Case) -> dict[str, Any]:
    """Run at the step and at a quarter of it; errors of the first run propagate."""
    full = measure(case)
    problems = dict(full.pop("problems"))
    if case.kind != "hold":  # a million steps run without comparison
        try:
            quarter = measure(replace(case, timestep=max(case.timestep / 4, 1.25e-4)))
        except SimulationError as error:
            quarter = {"force_N": np.nan, "flags": {}}
            problems["force"] = f"stop at a quarter of the time step: {error.reason}"
        full["force_quarter_N"] = quarter["force_N"]
        difference = abs(full["force_N"] - quarter["force_N"])
        if difference > FORCE_ERROR * max(abs(quarter["force_N"]), FORCE_FLOOR):
            problems["force"] = (
                f"force {full['force_N']:.4g} N, {quarter['force_N']:.4g} N at a quarter of the "
                "time step"
            )
    flags = full["flags"]
    full["problems"] = list(problems.values())
    unflagged = [
        text for kind, text in problems.items() if not _ACCOUNTED.get(kind, set()) & set(flags)
    ]
    if unflagged:
        return {**full, "outcome": "FAILED", "reason": "; ".join(unflagged)}
    return {
        **full,
        "outcome": "flagged" if flags else "ok",
        "reason": "; ".join([*problems.values(), *flags.values()]),
    }


def measure(case: Case) -> dict[str, Any]:
    """Run one case once; return its force, its flags, and the failed checks by kind."""
    design = case.design(load_sensor("paper16"))
    world, expected, settled = {
        "press": _press,
        "hold": _press,
        "drop": _drop,
        "rest": _drop,
        "pinch": _pinch,
    }[case.kind](case, design)
    force, energy = _force_and_energy(world, case)
    normal = float(-force[2])
    problems = {}
    depth = ground_truth.penetration(world, 0)
    if not settled and not any(case.shake):
        problems["settled"] = "does not settle"
    if energy[1] > 2 * energy[0] + 1e-8:
        problems["energy"] = f"kinetic energy grows from {energy[0]:.2g} to {energy[1]:.2g} J"
    if case.kind in ("press", "hold") and depth > PENETRATION * max(case.pressed, 3e-4):
        problems["penetration"] = f"penetration {depth * 1e3:.2g} mm of {case.pressed * 1e3:.2g} mm"
    if expected is not None and abs(normal - expected) > FORCE_ERROR * expected + 1e-4:
        problems["weight"] = f"force {normal:.4g} N, should be {expected:.4g} N"
    return {
        "force_N": normal,
        "penetration_mm": 1e3 * depth,
        "flags": world.flags,
        "problems": problems,
    }


def _press(case: Case, design: SensorDesign) -> tuple[World, float | None, bool]:
    world = PressWorld(
        design,
        Indenter.parse(case.indenter),
        at=case.at,
        timestep=case.timestep,
        mesh=case.mesh,
        mount=case.mount,
        shake=case.shake,
    )
    limit = 0.4 if any(case.shake) else 1.0
    world.inflate(case.pressure, seal=True)
    settled = world.press(case.pressed, speed=0.04)
    if case.shear:
        settled = world.press(case.pressed, case.shear, speed=0.04)
    if case.valve:
        sensor = world.sensors[0]
        {
            "open": lambda: sensor.open_valve(case.pressure),
            "vent": lambda: sensor.open_valve(0.0),
            "to 3 kPa": lambda: sensor.open_valve(3000.0),
            "puncture": lambda: sensor.puncture(1e-8),
            "pump": lambda: sensor.open_valve(-500.0),
        }[case.valve]()
        settled = world.settle(limit, speed=2e-4)
    if case.steps:
        world.step(case.steps)
    return world, None, settled


def _drop(case: Case, design: SensorDesign) -> tuple[World, float | None, bool]:
    world = DropWorld(
        design,
        FreeObject(case.body, case.size, case.mass),
        gauge_pressure=case.pressure,
        speed=case.speed,
        timestep=case.timestep,
        mesh=case.mesh,
        guided=case.kind == "drop",
    )
    return world, world.weight, _rest(world)


def _pinch(case: Case, design: SensorDesign) -> tuple[World, float | None, bool]:
    world = PinchWorld(
        design,
        FreeObject(case.body, case.size, case.mass),
        gauge_pressure=case.pressure,
        squeeze=case.depth,
        timestep=case.timestep,
        mesh=case.mesh,
    )
    settled = _rest(world)
    if isinstance(world, PinchWorld) and world.drop > 5e-3:
        world.update_flags({"unsettled": "the plate slips out"}, {Cadence.SETTLING})
    return world, None, settled


def _rest(world: World, limit: float = 2.5, speed: float = 2e-3) -> bool:
    """Step until all speeds are below `speed` for 0.1 s; a free ball may still creep."""
    still = 0.0
    while world.time < limit + 0.3 and still < 0.1:
        world.step()
        still = still + world.timestep if np.abs(world.data.qvel).max() < speed else 0.0
    if still < 0.1:
        reason = f"is not at rest after {limit:g} s"
        world.update_flags({"unsettled": reason}, {Cadence.SETTLING})
    return still >= 0.1


def _force_and_energy(world: World, case: Case) -> tuple[Any, tuple[float, float]]:
    """Return the mean force over 0.1 s, and the largest kinetic energy in its two halves.

    A shaken case is averaged over 0.5 s, whole periods.
    """
    count = round((0.5 if any(case.shake) else 0.1) / world.timestep)
    force = np.zeros(3)
    energy = np.zeros(count)
    for k in range(count):
        world.step()
        force += ground_truth.contact_force(world, 0) / count
        energy[k] = world.kinetic_energy
    return force, (float(energy[: count // 2].max()), float(energy[count // 2 :].max()))


_AXES = {
    "turned mount": "rotated mount",
    "free on a membrane": "free object on a membrane",
    "pinched sheet": "pinched plate",
}


def table(result: dict[str, Any]) -> str:
    """Format outcomes and flags by axis, and every refused or failed case with its reason."""
    rows = result["cases"]
    outcomes = [outcome for outcome in OUTCOMES if any(row["outcome"] == outcome for row in rows)]
    lines = [
        f"{len(rows)} cases: " + ", ".join(f"{n} {o}" for o, n in result["counts"].items()) + ".",
        "",
        "| axis | " + " | ".join(outcomes) + " | flags and stops: cases |",
        "|---" * (len(outcomes) + 2) + "|",
    ]
    for axis in dict.fromkeys(row["axis"] for row in rows):
        group = [row for row in rows if row["axis"] == axis]
        counts = Counter(row["outcome"] for row in group)
        cells = " | ".join(str(counts[o] or "") for o in outcomes)
        lines.append(f"| {_AXES.get(axis, axis)} | {cells} | {_flag_counts(group)} |")
    bad = [row for row in rows if row["outcome"] in ("refused", "FAILED")]
    if bad:
        lines += ["", "| case | outcome | failed checks, or reason |", "|---|---|---|"]
        lines += [f"| {_case(row)} | {row['outcome']} | {_reason(row)} |" for row in bad]
    return "\n".join(lines) + "\n"


def _flag_counts(rows: Sequence[dict[str, Any]]) -> str:
    """Return how many of the flagged cases have each flag, the most frequent first; a stop has no
    flag."""
    flagged = [row for row in rows if row["outcome"] == "flagged"]
    counts = Counter(flag for row in flagged for flag in row["flags"] or ("stop",))
    return ", ".join(f"`{flag}` {count}" for flag, count in counts.most_common())


def _case(row: dict[str, Any]) -> str:
    """Return the axis and the label of a case as shown in the table."""
    label = row["label"].replace("off the middle", "off center")
    return f"{_AXES.get(row['axis'], row['axis'])}: {label}"


def _reason(row: dict[str, Any]) -> str:
    """Return the failed checks; without any, the reason of the refusal."""
    return "; ".join(row.get("problems", ())) or row["reason"]


def _save(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    if (figure := new_figure(path.name, (11.0, 9.0))) is None:
        return
    plot(figure, rows)
    figure.savefig(path)


def plot(figure: Any, rows: Sequence[dict[str, Any]]) -> None:
    """Plot the map: one row of cells per axis, colored by outcome."""
    axes = figure.subplots()
    names = list(dict.fromkeys(row["axis"] for row in rows))
    for number, name in enumerate(names):
        for column, row in enumerate(r for r in rows if r["axis"] == name):
            axes.barh(number, 0.92, left=column, height=0.8, color=_COLOURS[row["outcome"]])
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set(
        xlabel="cases, in the order of the table",
        title="stability: "
        + ", ".join(f"{sum(r['outcome'] == o for r in rows)} {o}" for o in OUTCOMES),
    )
    axes.legend(
        [axes.barh(0, 0, color=colour) for colour in _COLOURS.values()],
        list(_COLOURS),
        ncols=4,
        loc="lower right",
    )
