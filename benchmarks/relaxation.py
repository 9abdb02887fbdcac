"""`mjtactile bench relaxation`: force errors during holds of ten minutes on rubber that relaxes.

One sensor models the relaxation and another does not. A ball of 8 mm stays pressed into `dense`
while the membrane stress fades. A noisy pressure sensor is read. Terms are a decade apart; their
fractions are those of `RUBBERS`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.relaxation import Relaxation, decades
from mjtactile.core.types import PressureReading
from mjtactile.experiments.test_bench import View, take_references
from mjtactile.recording.files import write_json
from mjtactile.report.figures import new_figure
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

RUBBERS = {"latex": 0.02, "five times latex": 0.1}
"""Fraction of the lasting stress that fades in each decade from 1 to 1000 s."""
DEPTH = 3.3e-3  # depth of the hold, m: 0.6 N
HOLD = 600.0
HOLD_QUICK = 20.0
AFTER = 10.0  # time after the release, s
_EVERY = 20.0  # interval between measurements, s
_IMAGES = 5  # averaged for a value, over 0.1 s, since one image alone has a noise of 5 mN
_GAUGE_SD = 5.0  # noise of the pressure sensor, Pa
_TIMED = 400  # timed steps
_TURNS = 6


def run(
    out: Path, *, quick: bool = False, notify: Callable[[str], None] = lambda _: None
) -> dict[str, Any]:
    """Measure each rubber; return one row each.

    Results so far are stored in `out`/relaxation.json.
    """
    rows: list[dict[str, Any]] = []
    for name, rate in RUBBERS.items():
        row = hold(rate, HOLD_QUICK if quick else HOLD)
        rows.append({"rubber": name, "rate": rate, **row})
        notify(
            f"{name}: worst {1e3 * row['worst_N'][0]:.0f} mN, without the section "
            f"{1e3 * row['worst_N'][1]:.0f} mN"
        )
        write_json(out / "relaxation.json", {"rows": rows})
    cost = _relative_cost()
    notify(f"a step costs {100 * (cost - 1):+.0f} %")
    result = {"rows": rows, "price": cost, "seconds": HOLD_QUICK if quick else HOLD}
    write_json(out / "relaxation.json", result)
    _plot(out, rows)
    return result


def hold(rate: float, seconds: float, seed: int = 0) -> dict[str, Any]:
    """Simulate a hold of `seconds` on rubber whose stress fades by `rate` per decade.

    Errors are pairs: of a sensor that models the relaxation and of one that does not.
    """
    elastic = load_sensor("dense")
    relaxing = _relaxing(elastic, rate)
    rng = np.random.default_rng(seed)
    world = PressWorld(relaxing, Indenter.parse("sphere:8"))
    views = [View(world, design, seed=seed) for design in (relaxing, elastic)]
    take_references(world, views, relaxing.chamber.supply_gauge)
    world.step(_steps(world, 1.0))
    world.drive(DEPTH)
    estimates = [_measure(world, views, rng)]
    while estimates[-1][0] - estimates[0][0] < seconds:
        world.step(_steps(world, _EVERY))
        estimates.append(_measure(world, views, rng))
    world.drive(-DEPTH)
    world.step(_steps(world, AFTER))
    _, left, *estimate_after = _measure(world, views, rng)
    held = np.array(estimates)
    errors = held[:, 2:] - held[:, 1:2]
    return {
        "true_N": [float(held[0, 1]), float(held[-1, 1])],
        "worst_N": np.abs(errors).max(axis=0).tolist(),
        "drift_N": (errors[-1] - errors[0]).tolist(),
        "after_N": [float(estimated - left) for estimated in estimate_after],
        "time_s": (held[:, 0] - held[0, 0]).tolist(),
        "error_N": errors.tolist(),
    }


def _relaxing(design: SensorDesign, rate: float) -> SensorDesign:
    return replace(design, relaxation=Relaxation(decades(rate, 1.0, 1e3)))


def _steps(world: PressWorld, seconds: float) -> int:
    return round(seconds / world.timestep)


def _measure(
    world: PressWorld, views: Sequence[View], rng: np.random.Generator
) -> tuple[float, float, float, float]:
    """Return time, true normal force, and the estimates of both sensors, averaged over some
    images."""
    rows = []
    for _ in range(_IMAGES):
        world.step(_steps(world, 0.02))
        pressure = world.sensors[0].gauge_pressure + float(rng.normal(0.0, _GAUGE_SD))
        reading = PressureReading(pressure, _GAUGE_SD, world.time)
        estimated = [
            view.perception.perceive(view.image(), world.time, reading).force_normal
            for view in views
        ]
        rows.append([-float(ground_truth.contact_force(world, 0)[2]), *estimated])
    true, modeled, unmodeled = np.mean(rows, axis=0)
    return world.time, float(true), float(modeled), float(unmodeled)


def _relative_cost() -> float:
    """Return the processor time of a step with relaxation over one without, under a ball.

    It is the median of several turns.
    """
    worlds = []
    for design in (_relaxing(load_sensor("dense"), 0.05), load_sensor("dense")):
        world = PressWorld(design, Indenter.parse("sphere:8"))
        world.sensors[0].sleepy = False
        world.inflate(design.chamber.supply_gauge, seal=True)
        world.drive(DEPTH)
        worlds.append(world)
    ratios = []
    for _ in range(_TURNS):
        spent = []
        for world in worlds:
            start = time.process_time()
            world.step(_TIMED)
            spent.append(time.process_time() - start)
        ratios.append(spent[0] / spent[1])
    return float(np.median(ratios))


def table(result: Mapping[str, Any]) -> str:
    """Format the result as a Markdown table."""
    lines = [
        "| rubber | relaxation per decade | true force, N | worst force error with `[relaxation]`, "
        "mN | without | 10 s after release (without), mN |",
        "|---|---|---|---|---|---|",
    ]
    for row in result["rows"]:
        start, end = row["true_N"]
        modeled, unmodeled = (1e3 * error for error in row["worst_N"])
        after, after_unmodeled = (1e3 * error for error in row["after_N"])
        lines.append(
            f"| {row['rubber']} | {row['rate']:.0%} | {start:.3f} to {end:.3f} | {modeled:.0f} | "
            f"{unmodeled:.0f} | {after:+.0f} ({after_unmodeled:+.0f}) |"
        )
    cost = 100 * (result["price"] - 1)
    note = (
        f"Holds of {result['seconds']:.0f} s. Required: at most 30 mN (target 15 mN). The cost of "
        f"a simulation step changes by {cost:+.0f} % (allowed 10 %)."
    )
    return "\n".join(lines) + f"\n\n{note}\n"


def _plot(out: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Plot the force error over the time held, `relaxation.png`."""
    if (figure := new_figure("relaxation.png", (6.4, 3.8))) is None:
        return
    axes = figure.add_subplot()
    for k, row in enumerate(rows):
        errors = 1e3 * np.array(row["error_N"])
        axes.plot(row["time_s"], errors[:, 0], f"C{k}-", label=row["rubber"])
        axes.plot(
            row["time_s"], errors[:, 1], f"C{k}:", label=f"{row['rubber']}, without [relaxation]"
        )
    axes.axhline(0.0, color="k", lw=0.8)
    axes.set(xlabel="hold time, s", ylabel="force error (estimate minus ground truth), mN")
    axes.legend(fontsize=8, ncols=2)
    figure.savefig(out / "relaxation.png")
