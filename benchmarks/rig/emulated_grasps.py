"""`mjtactile bench emulated`: a controller tuned in simulation, tested on the emulated gripper.

It works through servos, valves and cameras. Eggs and vials alternate. The outcome is determined
from the ground truth of the emulated world, which the controller cannot access.

`MJTACTILE_TIME_SCALE=4` is for a computer that is slower than real time.
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.rig.session import Bench
from mjtactile.core import scaled_clock
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import DeviceError
from mjtactile.evaluate.wilson import wilson
from mjtactile.recording.files import write_json
from mjtactile.runtime.controller import load_controller
from mjtactile.runtime.cycle import Cycle
from mjtactile.runtime.progress import Progress
from mjtactile.runtime.session import Session

CONTROLLER = "adaptive"
OBJECTS = ("egg", "vial")
GRASPS = 20
QUICK = 2
SENSOR = "dense"
_TIME_LIMIT = 60.0  # time limit of a grasp, s
_COMES_ALONG = 0.9  # minimum fraction of the lift height; an object rolls slightly when lifted
_STANDS = 3e-3  # maximum height difference after it is set down, m


def run(
    out: Path, quick: bool = False, resume: bool = False, episodes: int = GRASPS
) -> dict[str, Any]:
    """Grasp `episodes` times, each with a new emulator.

    Args:
        out: Folder; emulated.json is written after each grasp.
        quick: Two grasps.
        resume: Continue with the stored results.
        episodes: Number of grasps.

    Returns:
        `grasps`: a row each; `slow`: the slowdown factor of devices and host.
    """
    path = out / "emulated.json"
    rows = (
        json.loads(path.read_text(encoding="utf-8"))["grasps"] if resume and path.is_file() else []
    )
    notify = Progress().message
    for seed in range(len(rows), QUICK if quick else episodes):
        row = grasp(OBJECTS[seed % len(OBJECTS)], seed)
        notify(f"{row['object']}, seed {seed}: {row['outcome']} {row['reason']}".strip())
        rows.append(row)
        write_json(path, {"grasps": rows, "slow": scaled_clock.slow()})
    return {"grasps": rows, "slow": scaled_clock.slow()}


class _Watch:
    """Observer that stores the ground truth of each cycle."""

    def __init__(self, bench: Bench):
        self._process = bench.process
        self.start = float(self._process.truth()["object_height"])
        self.height = self.start
        self.presses: list[float] = []
        self.came_along = True

    def update(self, cycle: Cycle) -> None:
        if cycle.sent.phase != "hold":
            return
        true = self._process.truth()
        self.height = float(true["object_height"])
        risen = self.height - self.start
        self.came_along &= risen > _COMES_ALONG * float(true["lift_height"])
        self.presses.append((float(true["contact_1"]) + float(true["contact_2"])) / 2)


def grasp(object_name: str, seed: int) -> dict[str, Any]:
    """Lift, hold and set down one object.

    Args:
        object_name: Object on the emulated table.
        seed: Seed of its position and of the cameras' noise.

    Returns:
        `outcome` ("held", "dropped" or "fault"), `reason`, and the true force of the hold on each
        finger, `hold_N`, mean over time and fingers (None: never held).
    """
    bench = Bench("emulated", load_sensor(SENSOR), object_name=object_name, seed=seed)
    row: dict[str, Any] = {"object": object_name, "seed": seed, "hold_N": None}
    try:
        rig = bench.connect()
        try:
            watch = _Watch(bench)
            session = Session(rig)
            session.take_references()
            controller = load_controller(CONTROLLER)
            last = session.run(controller, time_limit=_TIME_LIMIT, on_cycle=watch.update)
            stands = abs(float(bench.process.truth()["object_height"]) - watch.start) < _STANDS
        finally:
            rig.close()
    except DeviceError as error:
        return row | {"outcome": "fault", "reason": str(error)}
    finally:
        bench.close()
    if watch.presses:
        row["hold_N"] = statistics.fmean(watch.presses)
    held = bool(watch.presses) and watch.came_along and stands and last.phase == "done"
    return row | {"outcome": "held" if held else "dropped", "reason": last.reason}


def table(result: Mapping[str, Any]) -> str:
    """Return the results by object, next to the requirement."""
    rows = result["grasps"]
    lines = [
        f"| `{CONTROLLER}` on the emulated gripper | required | held (95 % interval) | faults "
        "of the rig | grip force, N: median |",
        "|---" * 5 + "|",
    ]
    for name in OBJECTS:
        lines.append(_row(name, [row for row in rows if row["object"] == name], ""))
    lines.append(_row("all", rows, f"{GRASPS} of {GRASPS}"))
    if result["slow"] != 1:
        lines += ["", f"Devices and host ran at 1/{result['slow']:g} of real time."]
    return "\n".join(lines) + "\n"


def _row(name: str, rows: Sequence[Mapping[str, Any]], required: str) -> str:
    held = sum(row["outcome"] == "held" for row in rows)
    faults = sum(row["outcome"] == "fault" for row in rows)
    low, high = wilson(held, len(rows))
    grips = [row["hold_N"] for row in rows if row["hold_N"] is not None]
    grip = f"{statistics.median(grips):.2f}" if grips else ""
    fraction = f"{held} of {len(rows)} ({100 * low:.0f}-{100 * high:.0f} %)"
    return f"| {name} | {required} | {fraction} | {faults} | {grip} |"
