"""`mjtactile bench commissioning`: a rehearsal of the first day with a rig, on an emulated one that
has a real one's troubles all at once (models/rigs/emulated_first_day.toml).

Each step is the command that a user types, in this process, with a person at the terminal who reads
the instruments (`person`). True forces are read from the emulated world only to say what is felt
less true. The presses that `fit` needs are made on a simulated stage, with the left finger's sheet
and a camera that is as its file says.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmarks.commissioning.commissioning_steps import SEEDS, Day
from mjtactile.calibrate import interactive
from mjtactile.core import scaled_clock
from mjtactile.core.types import FINGERS
from mjtactile.devices import discovery

SLOW = 4.0  # the emulated world's time: two processors draw and look at two cameras
_HURRIED = (
    (discovery, "BAUDS", (1_000_000,)),
    (discovery, "IDS", range(1, 4)),
    (discovery, "_REPLY_TIME", 0.3),
    (interactive, "_SPEED", 0.1),
    (interactive, "_REST_TIME", 0.3),
    (interactive, "_VALVE_STAGES", (1.0, 1.0, 0.5)),
)
"""What is shortened of the commands' waiting: emulated jaws have nothing to settle."""


def run(
    out: Path,
    *,
    quick: bool = False,
    resume: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """The day, step by step; with `quick` one grasp before and after, and no shadow. What was done
    so far is kept in `out`/first_day.json: with `resume` a day that was cut off goes on."""
    if not resume:
        shutil.rmtree(out / "day", ignore_errors=True)
        (out / "first_day.json").unlink(missing_ok=True)
    seeds = SEEDS[:1] if quick else SEEDS
    with _hurried():
        day = Day(out, say)
        day.step("grasp, before", lambda: day.grasps("dense", day.bare(), seeds))
        day.step("setup", day.set_up)
        for finger in FINGERS:
            day.step(f"calibrate camera, {finger}", lambda finger=finger: day.lens(finger))
        day.step("record and fit", day.fit)
        for what in (["valve", "--seal", "2"], ["frame"], ["force", "--load-cell"], ["gripper"]):
            day.step(f"calibrate {what[0]}", lambda what=what: day.calibrate(*what))
        day.step("grasp, after", lambda: day.grasps(day.sensor, day.file, seeds))
        if not quick:
            day.step("shadow", day.shadow)
    return day.told()


@contextlib.contextmanager
def _hurried() -> Iterator[None]:
    before = [getattr(module, name) for module, name, _ in _HURRIED]
    slow = scaled_clock.slow()
    scaled_clock.set_slow(max(slow, SLOW))
    for module, name, value in _HURRIED:
        setattr(module, name, value)
    try:
        yield
    finally:
        scaled_clock.set_slow(slow)
        for (module, name, _), value in zip(_HURRIED, before, strict=True):
            setattr(module, name, value)


def table(result: Mapping[str, Any]) -> str:
    """The result as Markdown."""
    lines = ["| step | what came of it |", "|---|---|"]
    for row in result["steps"]:
        name = row["step"]
        came = f"failed: {row['failed']}" if "failed" in row else _came(name, row)
        lines.append(f"| {name} | {came} |")
    live = [row for row in result["steps"] if row["step"] not in ("record and fit", "shadow")]
    minutes = sum(row["seconds"] for row in live) / 60
    note = (
        f"Felt less true force is asked to be within {result['asked_N']:g} N. All but fit "
        f"and shadow took {minutes:.0f} minutes of the emulated rig's time, with the waiting "
        "of some commands shortened."
    )
    return "\n".join(lines) + f"\n\n{note}\n"


def _came(step: str, row: Mapping[str, Any]) -> str:
    """What a step came to, in words."""
    if step.startswith("grasp"):
        means = [f"{left:+.3f}, {right:+.3f}" for left, right in row["mean_N"]]
        return (
            f"an egg is held {len(means)} times; felt less true on each finger (left, right), N, "
            f"means: {'; '.join(means)}; worst image {row['worst_N']:.3f}"
        )
    if step == "setup":
        told = "told apart" if row["cameras_told_apart"] else "taken for each other"
        return f"{row['questions']} questions; the cameras are {told}"
    if "fx_px" in row:
        (true, found), (cx, found_cx) = row["fx_px"], row["cx_px"]
        return f"focal length {found:.1f} px ({true:.0f} truly), centre {found_cx:.1f} ({cx:.1f})"
    if "young_MPa" in row:
        (young, found), (stretch, found_stretch) = row["young_MPa"], row["pre_stretch"]
        quick, found_quick = row["quick_over_lasting_less_1"]
        return (
            f"modulus {found:.2f} MPa ({young:.2f} truly when all has faded), pre-stretch "
            f"{found_stretch:.3f} ({stretch:.3f}), {found_quick:.0%} fade within the recording "
            f"({quick:.0%} in 1000 s)"
        )
    return row.get("verdict", "good")
