"""`mjtactile compare-sim`: compare a recording with a simulation driven by the same commands."""

from __future__ import annotations

import argparse
import math
import os
from pathlib import Path

from mjtactile.commands import arguments as arg
from mjtactile.commands.output import output_folder, print_json, stdout_to_stderr
from mjtactile.recording.files import write_json
from mjtactile.runtime.progress import Progress
from mjtactile.sim_comparison.discrepancy_parameters import CAUSES

DESCRIPTION = """\
Compare a recording of a real or emulated rig with a simulation that gets the same commands at
the same times (or the same motions of a stage). Report when forces, markers and pressures start
to differ, and which single cause would explain most of the difference: each cause is simulated.
Recommended for the first day with a real sensor."""
EPILOG = f"""\
examples:
  mjtactile grasp --rig my_gripper.toml --object egg --out runs/real
  mjtactile compare-sim runs/real --out runs/real_shadow
  mjtactile compare-sim runs/real --rig my_sim_gripper.toml --end-s 4 --out runs/real_shadow
  mjtactile compare-sim runs/press_3 --json                 a recording of `record --protocol`

Writes shadow.html (curves, a table of causes) and shadow.json. Causes:
{", ".join(cause.name for cause in CAUSES)}.
Capabilities and limits: docs/how-to/integrations.md.
exit codes: 0 agrees with the simulator, 1 differs, 2 bad input, 3 the simulation failed.
"""

ARGUMENTS = (
    arg.positional("recording", "RECORDING", "a recording, or a run's folder", type=Path),
    arg.option("--rig NAME|FILE.toml", "simulated rig that represents the recorded rig", "sim"),
    arg.option("--object NAME|FILE.xml", "grasped object (default: from the recording)"),
    arg.option(
        "--end-s S",
        "use only the first S seconds (default: all)",
        math.inf,
        dest="until",
        type=arg.POSITIVE,
    ),
    arg.repeated(
        "--parameter",
        "try this cause; repeatable (default: all)",
        choices=[cause.name for cause in CAUSES],
    ),
    arg.option(
        "--workers N",
        "number of simulation processes (default: half of the processors)",
        max(1, (os.cpu_count() or 1) // 2),
        type=arg.integer(1, 64),
    ),
    arg.out("folder for the HTML report and its numbers"),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile.sim_comparison.compare import shadow_of
    from mjtactile.sim_comparison.html_report import numbers, page

    progress = Progress(quiet=options.json)
    with stdout_to_stderr():
        shadow, episode = shadow_of(
            options.recording,
            rig=options.rig,
            item=options.object or "",
            until=options.until,
            causes=options.parameter,
            workers=options.workers,
            notify=progress.message,
        )
    result = numbers(shadow, episode.fingers) | {"recording": str(options.recording)}
    if options.out is not None:
        with output_folder(options.out, "shadow.html", "shadow.json") as out:
            write_json(out / "shadow.json", result)
            text = page(shadow, episode.fingers, f"{options.recording} and its simulation")
            (out / "shadow.html").write_text(text, encoding="utf-8")
    if options.json:
        print_json(result)
        return int(shadow.differs)
    print(f"{options.recording}: {result['verdict']}")
    if result["remedy"]:
        print(f"  {result['remedy']}")
    if options.out is not None:
        print(f"  {options.out}/shadow.html")
    return int(shadow.differs)
