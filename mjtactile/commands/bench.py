"""`mjtactile bench`: measure, write a table, a JSON and plots."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mjtactile import InputError
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import insert_table, output_folder, print_json, stdout_to_stderr
from mjtactile.commands.repository_only import of_checkout
from mjtactile.recording.files import write_json

DESCRIPTION = """\
Measure, with fixed seeds, and write NAME.json, NAME.md and plots into a folder:
  grasp       egg, strawberry and vial with seeds 0-9: outcome, force error, real-time factor
              and where the time goes
  perception  marker accuracy against the Cramer-Rao bound, and speed, next to OpenCV's tools
  tracking    markers that are followed against a search of every image, a hundred thousand images
  touch       force, shear, torque, patch, smallest touch and error bars, random indenters
  bars        error bars of felt wrenches, 10^4 images of random scenes
  slip        two hundred random slips and holds: how many are detected, how soon, false alarms
  material    class and modulus of random bodies, probed
  stability   more than 300 hard cases of the simulation, each judged by physics
  rig         the emulated rig: loop rate, latency, reaction to every fault, host killed
  accuracy    work-precision diagrams: error of force and surface against time, every knob
  levels      the levels without a mesh in the same measures, and whether episodes end alike
  speed       two membranes holding an object: against the clock, rigid pads, mesh size
  cheap       episodes without images against episodes with them: markers, forces, time
  drawn       what a sensor's chain errs by in grasps, for --effects=-sheet,-chain
  learning    steps, episodes, outcomes and memory at each level of simulation, for learning
  policy      a policy learned from nothing in ten minutes, judged drawn and in full
  effects     what each effect costs, and what leaving it out costs
  film        the film against an independent sheet, its scatter over places, and its time
  thin        blades, wires, pins and small faces, at random places and speeds: their force
  shape       what body touches: contact area, kind, radius and edge, from images alone
  sensors     the shipped marker layouts on one membrane: what more markers tell, and their cost
  outline     round and elliptic sensors: bulge against theory, presses felt less true
  explore     whole objects touched twelve times: how far their surface is from the true one
  fit         sensors that differ from their file, recorded and fitted: each number's error
  truth       the simulation and what is felt, against references from outside of the project
  studio      what watching costs: an egg grasp in Studio, a page looking on, against it alone
  trust       air that is not as it was, and a grasp felt again under fifty camera troubles
  fiducials   the same with circles that do not move: knocks, zoom, focus, levels; their price
  attacks     everything bad that the tests do, counted by what must come of it
  settings    what half and twice of each number of the sensing chain do to what is felt
  gauge       the same of the filter that follows a pressure gauge
  seen        the same of photographs, and where markers fit no shape
  bodies      the same of what body touches
  relaxation  holds of ten minutes on rubber that relaxes: felt less true, and the price
  first_day   setup, calibrate, fit, grasp and shadow of an emulated rig with every trouble
  tasks       what touch buys: tasks that ask for it, with and without, over the same episodes
  numbers     measures nothing: all numbers on one page, from the pages of the others
  headline    measures nothing: the few of them that the README shows"""
EPILOG = """\
examples:
  mjtactile bench grasp --quick            one seed instead of ten
  mjtactile bench perception --out results
  mjtactile bench grasp --readme docs/validation/benchmarks.md
      put the table between that file's bench markers
  mjtactile bench truth --cases my_cases   a TOML file each; shipped: models/reference_cases
  mjtactile bench numbers --readme docs/validation/results.md     then take all numbers from there
  mjtactile bench headline --readme README.md          and the README's
"""
BENCHMARKS = {
    "grasp": "grasp",
    "speed": "speed.run",
    "accuracy": "accuracy.run",
    "levels": "accuracy.meshless_levels",
    "effects": "effects",
    "perception": "perception.run",
    "material": "material",
    "touch": "touch.run",
    "bars": "uncertainty.run",
    "slip": "slip.run",
    "tracking": "tracking",
    "cheap": "without_images",
    "rig": "rig.run",
    "emulated": "rig.emulated_grasps",
    "stability": "stability.run",
    "truth": "reference_cases.run",
    "film": "quasistatic",
    "drawn": "learning.fit_error_model",
    "learning": "learning.run",
    "policy": "learning.policy",
    "thin": "thin_objects.run",
    "shape": "shape.run",
    "sensors": "sensors",
    "outline": "outline",
    "explore": "explore",
    "fit": "fit",
    "design": "design",
    "studio": "studio.run",
    "trust": "camera_faults.run",
    "fiducials": "camera_faults.fiducials",
    "attacks": "fault_injection",
    "settings": "setting_sensitivity",
    "gauge": "gas_filter_sensitivity",
    "seen": "detection_sensitivity",
    "bodies": "shape.shape_setting_sensitivity",
    "relaxation": "relaxation",
    "first_day": "commissioning.run",
    "tasks": "tasks.run",
    "bubble": "real.bubble",
    "dots": "real.dots",
    "numbers": "results_tables",
    "headline": "readme_table",
}
"""Name to module of the checkout's folder `benchmarks`; each has `run(out, quick) -> dict`, which
draws into `out`, and `table(result) -> str` in Markdown."""

OPTIONS = {
    "resume": (
        "stability",
        "rig",
        "emulated",
        "bars",
        "tasks",
        "attacks",
        "explore",
        "trust",
        "first_day",
        "outline",
    ),
    "parts": ("rig", "slip", "tasks"),
    "level": ("tasks",),
    "rate": ("slip",),
    "soak": ("rig",),
    "cases": ("truth",),
    "data": ("bubble", "dots"),
    "against": ("speed",),
    "pairs": ("cheap", "learning", "levels"),
    "episodes": ("tasks", "slip", "emulated"),
    "sensor": ("drawn",),
}
"""Options that only some have."""

ARGUMENTS = (
    arg.positional(
        "name", "NAME", f"what to measure: {', '.join(BENCHMARKS)}", choices=list(BENCHMARKS)
    ),
    arg.flag("--quick", "a small part of it, to see that it works"),
    arg.option("--out", "DIR", "folder for the results", Path("bench-results"), type=Path),
    arg.flag(
        "--resume",
        "stability, rig, emulated, bars, tasks, attacks, explore, trust, first_day, "
        "outline: keep what an interrupted run finished",
    ),
    arg.option(
        "--parts",
        "A,B,…",
        "rig: only these of loop, bus, fuzz, killed, stopped, stuck, outcomes, faults, soak; "
        "slip: of passive, tested; tasks: of adaptive, gentle, slip_aware, touchless, oracle",
    ),
    arg.option(
        "--level",
        "NAME",
        "tasks: mesh (default), film (--effects=-sheet,-images) or drawn (-sheet,-chain), which "
        "also say how far they agree with what lies of mesh in the same --out",
    ),
    arg.option("--data", "DIR", "bubble, dots: the recordings, which are not in here", type=Path),
    arg.option("--cases", "DIR", "truth: the cases of this folder", type=Path),
    arg.option(
        "--against", "DIR", "speed: also compare with another checkout, in turns", type=Path
    ),
    arg.option(
        "--soak",
        "HOURS",
        "rig: also so much of the long run: a grip every 20 s, a fault every 5 min, all of "
        "it recorded (--parts soak: only that, two hours)",
        type=float,
    ),
    arg.option("--pairs", "N", "cheap, learning, levels: so many pairs of episodes", type=int),
    arg.option(
        "--episodes",
        "N",
        "tasks, slip: so many of each (default: 200); emulated: so many grasps (default: 20)",
        type=int,
    ),
    arg.option("--rate", "HZ", "slip: of the cameras, 30 or 60 (default: 30)", type=float),
    arg.option("--sensor", "NAME", "drawn: of this sensor (default: dense)"),
    arg.option(
        "--readme",
        "FILE.md",
        "also put the table into this file, between <!-- bench:NAME --> and <!-- /bench -->",
        type=Path,
    ),
)


def run(options: argparse.Namespace) -> int:
    more: dict[str, Any] = {}
    for option, names in OPTIONS.items():
        value = getattr(options, option)
        if value and options.name not in names:
            raise InputError(
                f"not an option of 'bench {options.name}'", field=f"--{option}", choices=names
            )
        if value:
            more[option] = tuple(value.split(",")) if option == "parts" else value
    with output_folder(options.out) as out, stdout_to_stderr():
        module = of_checkout(BENCHMARKS[options.name])
        result = module.run(out, quick=options.quick, **more)
        table = module.table(result)
        write_json(out / f"{options.name}.json", result)
        (out / f"{options.name}.md").write_text(table, encoding="utf-8")
        if options.readme is not None:
            insert_table(options.readme, result.get("block", options.name), table)
    if options.json:
        print_json(result)
    else:
        print(f"{table}\nwritten to {options.out}")
    return 0
