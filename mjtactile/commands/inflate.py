"""`mjtactile inflate`: the bulge test of a sensor's membrane, against theory."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mjtactile import InputError, load_sensor
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import (
    exit_code_of_steps,
    optional_folder,
    print_flags,
    print_result,
    save_plot,
    stdout_to_stderr,
)
from mjtactile.recording.files import write_json
from mjtactile.runtime.progress import Progress

DESCRIPTION = """\
Connect the chamber to a supply at each pressure and let the simulated membrane settle. Report
its height, volume, area and stretch, and the theoretical height of the same membrane for any
outline (Ritz method, docs/theory/closed_forms.md, Eq. M8)."""
EPILOG = """\
examples:
  mjtactile inflate --sensor dense --pressure-kPa 1
  mjtactile inflate --sensor my_sensor.toml --pressure-kPa 0:4:0.5 --out runs/bulge

JSON: {"sensor": …, "steps": [{"pressure_kPa", "centre_height_mm", "volume_mL" (gas in
chamber and bulge), "area_mm2", "max_stretch" (relative to the unstretched membrane),
"theory_height_mm" (null where the rubber cannot hold the pressure), "converged"}],
"stopped": null, or the reason for missing steps (interrupted, simulation failed),
"flags": {kind: {"reason", "first_s", "last_s", "fraction"}}}
"""

ARGUMENTS = (
    arg.sensor(),
    arg.option(
        "--pressure-kPa P[:P2:STEP]",
        "gauge pressure in kPa, or a range, both ends included",
        dest="pressures",
        type=arg.values,
        required=True,
    ),
    arg.out("folder for inflate.json and inflate.png"),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile.experiments.indentation import inflate

    design = load_sensor(options.sensor)
    lowest = -1e-3 * design.chamber.ambient
    if min(options.pressures) <= lowest:
        message = f"{min(options.pressures):g} kPa is not above vacuum ({lowest:g} kPa)"
        raise InputError(message, field="--pressure-kPa")
    with optional_folder(options.out, "inflate.json", "inflate.png") as out:
        with stdout_to_stderr():
            result = inflate(
                design,
                [1e3 * p for p in options.pressures],
                notify=Progress(quiet=options.json).message,
                keep_partial=True,
            )
        if out is not None:
            write_json(out / "inflate.json", result)
            save_plot(out / "inflate.png", lambda figure: _plot(figure, result))
    print_result(options, result, lambda: _print_table(result, options.out))
    return exit_code_of_steps(result, len(options.pressures))


def _print_table(result: dict[str, Any], out: Path | None) -> None:
    print("pressure kPa  height mm  theory mm  volume mL   area mm2  max stretch")
    for s in result["steps"]:
        print(
            f"{s['pressure_kPa']:12.3f} {s['centre_height_mm']:10.4f} "
            f"{s['theory_height_mm']:10.4f} {s['volume_mL']:10.4f} {s['area_mm2']:10.2f} "
            f"{s['max_stretch']:12.4f}{'' if s['converged'] else '  not settled'}"
        )
    print_flags(result["flags"])
    if out is not None:
        print(f"inflate.json and inflate.png were written to {out}")


def _plot(figure: Any, result: dict[str, Any]) -> None:
    steps = result["steps"]
    axes = figure.subplots()
    pressures = [s["pressure_kPa"] for s in steps]
    axes.plot(pressures, [s["theory_height_mm"] for s in steps], "k-", lw=1, label="theory")
    axes.plot(pressures, [s["centre_height_mm"] for s in steps], "o", ms=5, label="simulated")
    axes.set(
        xlabel="gauge pressure, kPa",
        ylabel="height at the center, mm",
        title=f"bulge test, sensor {result['sensor']}",
    )
    axes.legend()
    axes.grid(alpha=0.3)
