"""`mjtactile bench`: measure, write a table, a JSON and plots."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mjtactile import InputError
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import (
    insert_table,
    output_folder,
    page_of_table,
    print_result,
    stdout_to_stderr,
)
from mjtactile.commands.repository_only import of_checkout
from mjtactile.recording.files import write_json

BENCHMARKS: dict[str, tuple[str, str]] = {
    "grasp": ("grasp", "egg, strawberry and vial, seeds 0-9: outcome, force error, speed, profile"),
    "perception": ("perception.run", "marker accuracy against the Cramer-Rao bound and OpenCV"),
    "tracking": ("tracking", "tracked markers against a full search, 100 000 images"),
    "touch": ("touch.run", "force, shear, torque, contact and threshold, random indenters"),
    "uncertainty": ("uncertainty.run", "coverage of the standard deviations, 10 000 random images"),
    "slip": ("slip.run", "200 random slips and stable grasps: detection rate, delay, false alarms"),
    "material": ("material", "material class and modulus of random objects, probed"),
    "stability": ("stability.run", "more than 300 hard cases of the simulation, each with a check"),
    "rig": ("rig.run", "emulated rig: loop rate, latency, reaction to every fault, killed host"),
    "emulated": ("rig.emulated_grasps", "grasps on the emulated rig"),
    "accuracy": ("accuracy.run", "work-precision diagrams: error against time, for every setting"),
    "meshless": ("accuracy.meshless_levels", "levels without a mesh: accuracy, outcomes"),
    "speed": ("speed.run", "two membranes that grip an object: real-time factor against mesh size"),
    "no-images": ("without_images", "episodes with and without rendered images: markers, forces"),
    "error-model": (
        "learning.fit_error_model",
        "errors of a pipeline, for --effects=-mesh,-pipeline",
    ),
    "learning": ("learning.run", "steps per second, outcomes and memory of each fidelity level"),
    "gpu": ("gpu.run", "grasps in MuJoCo Warp: agreement with the CPU; speed on a GPU"),
    "policy": ("learning.policy", "a policy trained in ten minutes, at two fidelity levels"),
    "effects": ("effects", "cost of each effect, and the error without it"),
    "quasistatic": ("quasistatic", "quasi-static membrane against an independent solver: error"),
    "thin-objects": ("thin_objects.run", "blades, wires, pins and small faces: force"),
    "shape": ("shape.run", "contact shape from images: area, kind, radius and edge direction"),
    "sliding-faces": ("sliding_faces", "steadiness of the force of a face that slides"),
    "wide-faces": ("wide_faces", "plates wider than the frame: force error by pressure sensor"),
    "cube-grasps": ("cube_grasps", "cubes held in the gripper: force error by sensor"),
    "sensors": ("sensors", "marker layouts on one membrane: accuracy and cost of more markers"),
    "outline": ("outline", "round and elliptic sensors: bulge against theory, force error"),
    "explore": ("explore", "whole objects touched twelve times: error of the estimated surface"),
    "fit": ("fit", "identification of sensors that differ from their file: parameter errors"),
    "design": ("design", "predictions of `design` against simulated sensors"),
    "references": ("reference_cases.run", "simulation and estimates against independent solutions"),
    "studio": ("studio.run", "cost of Studio: a grasp with and without a page that shows it"),
    "camera-faults": (
        "camera_faults.run",
        "gas faults; a grasp replayed under fifty camera faults",
    ),
    "fiducials": ("camera_faults.fiducials", "the same with fiducials: shift, zoom, focus, cost"),
    "fault-injection": ("fault_injection", "every malformed input of the tests, by reaction"),
    "setting-sensitivity": ("setting_sensitivity", "estimates with half and twice each setting"),
    "gas-filter-sensitivity": ("gas_filter_sensitivity", "the same for the gas filter"),
    "detection-sensitivity": ("detection_sensitivity", "the same for detection in photographs"),
    "shape-sensitivity": ("shape.shape_setting_sensitivity", "the same for the contact shape"),
    "relaxation": ("relaxation", "grasps of ten minutes on relaxing rubber: force error and cost"),
    "commissioning": ("commissioning.run", "setup, calibration, fit, grasp of a faulty rig"),
    "tasks": ("tasks.run", "benefit of touch: tasks with and without touch, same episodes"),
    "suite-v2": ("tasks.suite_v2", "ten tasks, controllers with touch, paired differences"),
    "friction": ("friction", "likelihoods of the signs of the friction filter, grasps"),
    "bubble": ("real.bubble", "recorded data of a real air-filled bubble sensor"),
    "dots": ("real.dots", "recorded data of a real dot-marker sensor"),
    "benchmark-index": ("benchmark_index", "no measurement: headline results"),
    "flags-page": ("flags_page", "no measurement: print the table of all flags"),
    "command-page": ("command_page", "no measurement: print the table of a command's fields"),
    "readme-table": ("readme_table", "no measurement: print the rows of the README"),
}
"""Benchmarks by name: module in the folder `benchmarks`, and description.

Each module has `run(out, quick) -> dict`, which plots into `out`. Its function `table(result) ->
str` returns Markdown.
"""

DESCRIPTION = "\n".join(
    [
        "Measure with fixed seeds; write NAME.json, NAME.md and plots into a folder:",
        *(f"  {name:24}{about}" for name, (_, about) in BENCHMARKS.items()),
    ]
)
EPILOG = """\
examples:
  mjtactile bench grasp --quick            one seed instead of ten
  mjtactile bench perception --out results
  mjtactile bench grasp --readme           insert the table into the benchmark's page
  mjtactile bench references --cases my_cases   one TOML file each; shipped: models/reference_cases
  mjtactile bench benchmark-index --readme collect headline results
"""
OPTIONS = {
    "resume": (
        "stability",
        "rig",
        "emulated",
        "uncertainty",
        "tasks",
        "fault-injection",
        "explore",
        "camera-faults",
        "commissioning",
        "fit",
        "outline",
        "suite-v2",
        "friction",
    ),
    "parts": ("rig", "slip", "tasks"),
    "level": ("tasks",),
    "rate": ("slip",),
    "soak": ("rig",),
    "cases": ("references",),
    "data": ("bubble", "dots"),
    "baseline": ("speed",),
    "pairs": ("gpu", "no-images", "learning", "meshless"),
    "episodes": ("tasks", "slip", "emulated", "suite-v2", "friction"),
    "sensor": ("error-model",),
}
"""Options that apply to some benchmarks only."""

_OWN_PAGE = Path()
"""Value of `--readme` without a file."""
ARGUMENTS = (
    arg.positional("name", "NAME", "benchmark from the list above", choices=list(BENCHMARKS)),
    arg.flag("--quick", "run a small part, to check that the benchmark works"),
    arg.option("--out DIR", "folder for the results", Path("bench-results"), type=Path),
    arg.flag(
        "--resume", f"keep the results of an interrupted run ({', '.join(OPTIONS['resume'])})"
    ),
    arg.option(
        "--parts A,B,…",
        "only these parts; rig: loop, bus, fuzz, killed, stopped, stuck, outcomes, faults, soak; "
        "slip: passive, tested; tasks: adaptive, gentle, slip_aware, touchless, oracle",
    ),
    arg.option(
        "--level NAME",
        "tasks: fidelity level mesh (default), quasistatic (--effects=-mesh,-images) or synthetic "
        "(-mesh,-pipeline); the last two also report agreement with mesh results in --out",
    ),
    arg.option(
        "--data DIR",
        "bubble, dots: folder of the recordings, which are not in the repository",
        type=Path,
    ),
    arg.option("--cases DIR", "references: read the cases of this folder", type=Path),
    arg.option("--baseline DIR", "speed: also time another checkout, alternating", type=Path),
    arg.option(
        "--soak HOURS",
        "rig: duration of the long run, with a grasp every 20 s and a fault every 5 min, all "
        "recorded (--parts soak: only the long run, two hours)",
        type=float,
    ),
    arg.option(
        "--pairs N", "gpu, no-images, learning, meshless: number of pairs of episodes", type=int
    ),
    arg.option(
        "--episodes N",
        "tasks, slip: episodes of each kind (default: 200; suite-v2: 24, friction: 12); emulated: "
        "grasps (default: 20)",
        type=int,
    ),
    arg.option("--rate HZ", "slip: camera rate, 30 or 60 (default: 30)", type=float),
    arg.option("--sensor NAME", "error-model: sensor (default: dense)"),
    arg.option(
        "--readme FILE.md",
        "also insert the table into this file, between <!-- bench:NAME --> and <!-- /bench -->; "
        "without a file: into the page of the documentation that has these markers",
        type=Path,
        nargs="?",
        const=_OWN_PAGE,
    ),
)


def run(options: argparse.Namespace) -> int:
    more: dict[str, Any] = {}
    for option, names in OPTIONS.items():
        value = getattr(options, option)
        if not value:
            continue
        if options.name not in names:
            message = f"this option does not apply to 'bench {options.name}'"
            raise InputError(message, field=f"--{option}", choices=names)
        more[option] = tuple(value.split(",")) if option == "parts" else value
    with output_folder(options.out) as out, stdout_to_stderr():
        module = of_checkout(BENCHMARKS[options.name][0])
        result = module.run(out, quick=options.quick, **more)
        table = module.table(result)
        write_json(out / f"{options.name}.json", result)
        (out / f"{options.name}.md").write_text(table, encoding="utf-8")
        if options.readme is not None:
            block = result.get("block", options.name)
            page = page_of_table(block) if options.readme == _OWN_PAGE else options.readme
            insert_table(page, block, table)
    print_result(options, result, f"{table}\nwritten to {options.out}")
    return 0
