"""`mjtactile bench emulated`: does a controller's file that was made in simulation hold what it
grasps on the emulated gripper, through servos, valves and cameras? Eggs and vials in turn, by the
truth of the emulated world, which only this program sees.

`MJTACTILE_TIME_SCALE=4` is for a computer that does not keep up with real time.
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
_TIME_LIMIT = 60.0  # s
_COMES_ALONG = 0.9  # of what the hand has risen: a thing rolls a little as it is lifted
_STANDS = 3e-3  # m off the height at which it stood


def run(
    out: Path, quick: bool = False, resume: bool = False, episodes: int = GRASPS
) -> dict[str, Any]:
    """Grasp `episodes` times, each with an emulator of its own.

    Args:
        out: Gets emulated.json after each grasp.
        quick: Two grasps.
        resume: Go on with what is there.
        episodes: How many.

    Returns:
        `grasps`: a row each; `slow`: by how much devices and host were slowed.
    """
    path = out / "emulated.json"
    rows = (
        json.loads(path.read_text(encoding="utf-8"))["grasps"] if resume and path.is_file() else []
    )
    say = Progress().message
    for seed in range(len(rows), QUICK if quick else episodes):
        row = grasp(OBJECTS[seed % len(OBJECTS)], seed)
        say(f"{row['object']}, seed {seed}: {row['outcome']} {row['reason']}".strip())
        rows.append(row)
        write_json(path, {"grasps": rows, "slow": scaled_clock.slow()})
    return {"grasps": rows, "slow": scaled_clock.slow()}


class _Watch:
    """The truth beside each cycle."""

    def __init__(self, bench: Bench):
        self._process = bench.process
        self.start = float(self._process.truth()["object_height"])
        self.height = self.start
        self.presses: list[float] = []
        self.came_along = True

    def look(self, cycle: Cycle) -> None:
        if cycle.sent.phase != "hold":
            return
        true = self._process.truth()
        self.height = float(true["object_height"])
        risen = self.height - self.start
        self.came_along &= risen > _COMES_ALONG * float(true["lift_height"])
        self.presses.append((float(true["contact_1"]) + float(true["contact_2"])) / 2)


def grasp(object_name: str, seed: int) -> dict[str, Any]:
    """Lift, hold and set down one thing.

    Args:
        object_name: What stands on the emulated table.
        seed: Where it stands, and the cameras' noise.

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
            last = session.run(controller, time_limit=_TIME_LIMIT, on_cycle=watch.look)
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
    """By object, what was asked for beside it."""
    rows = result["grasps"]
    lines = [
        f"| `{CONTROLLER}` on the emulated gripper | asked | held, with its 95 % interval | faults "
        "of the rig | grip, N: median |",
        "|---" * 5 + "|",
    ]
    for name in OBJECTS:
        lines.append(_row(name, [row for row in rows if row["object"] == name], ""))
    lines.append(_row("all", rows, f"{GRASPS} of {GRASPS}"))
    if result["slow"] != 1:
        lines += ["", f"Devices and host ran at 1/{result['slow']:g} of the speed."]
    return "\n".join(lines) + "\n"


def _row(name: str, rows: Sequence[Mapping[str, Any]], asked: str) -> str:
    held = sum(row["outcome"] == "held" for row in rows)
    faults = sum(row["outcome"] == "fault" for row in rows)
    low, high = wilson(held, len(rows))
    grips = [row["hold_N"] for row in rows if row["hold_N"] is not None]
    grip = f"{statistics.median(grips):.2f}" if grips else ""
    share = f"{held} of {len(rows)} ({100 * low:.0f}-{100 * high:.0f} %)"
    return f"| {name} | {asked} | {share} | {faults} | {grip} |"
