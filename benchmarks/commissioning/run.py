"""`mjtactile bench commissioning`: a rehearsal of the first day with a rig, on an emulated one.

The emulated rig has all deviations and faults of a real one together
(models/rigs/emulated_commissioning.toml).

Each step is the command that a user types, run in this process. A simulated operator at the
terminal reads the instruments (`simulated_operator`). True forces of the emulated world serve only
to compute force errors. The loads that `fit` needs are recorded on a simulated stage. It has the
left finger's membrane and a camera as in its file.
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

SLOW = 4.0  # time scale of the emulated world: two processors render and evaluate two cameras
_HURRIED = (
    (discovery, "BAUDS", (1_000_000,)),
    (discovery, "IDS", range(1, 4)),
    (discovery, "_REPLY_TIME", 0.3),
    (interactive, "_SPEED", 0.1),
    (interactive, "_REST_TIME", 0.3),
    (interactive, "_VALVE_STAGES", (1.0, 1.0, 0.5)),
)
"""Waiting times of commands that are shortened: emulated jaws settle at once."""


def run(
    out: Path,
    *,
    quick: bool = False,
    resume: bool = False,
    notify: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Run the day, step by step.

    With `quick` there is one grasp before and one after, and no shadow comparison. Results so far
    are stored in `out`/commissioning.json. With `resume` an interrupted day continues.
    """
    if not resume:
        shutil.rmtree(out / "day", ignore_errors=True)
        (out / "commissioning.json").unlink(missing_ok=True)
    seeds = SEEDS[:1] if quick else SEEDS
    with _short_waits():
        day = Day(out, notify)
        day.step("grasp, before", lambda: day.grasps("dense", day.bare(), seeds))
        day.step("setup", day.set_up)
        for finger in FINGERS:
            day.step(f"calibrate camera, {finger}", lambda finger=finger: day.lens(finger))
        day.step("record and fit", day.fit)
        for arguments in (
            ["valve", "--seal", "2"],
            ["frame"],
            ["force", "--load-cell"],
            ["gripper"],
        ):
            day.step(
                f"calibrate {arguments[0]}", lambda arguments=arguments: day.calibrate(*arguments)
            )
        day.step("grasp, after", lambda: day.grasps(day.sensor, day.file, seeds))
        if not quick:
            day.step("shadow", day.shadow)
    return day.results()


@contextlib.contextmanager
def _short_waits() -> Iterator[None]:
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
    """Format the result as a Markdown table."""
    lines = ["| step | result |", "|---|---|"]
    for row in result["steps"]:
        name = row["step"]
        came = f"failed: {row['failed']}" if "failed" in row else _describe_result(name, row)
        lines.append(f"| {_STEPS.get(name, name)} | {came} |")
    live = [row for row in result["steps"] if row["step"] not in ("record and fit", "shadow")]
    minutes = sum(row["seconds"] for row in live) / 60
    note = (
        f"Required: force error (estimate minus ground truth) within {result['asked_N']:g} N. All "
        f"steps except fit and compare-sim took {minutes:.0f} minutes of emulated time; some "
        "waiting times were shortened."
    )
    return "\n".join(lines) + f"\n\n{note}\n"


_STEPS = {
    "grasp, before": "grasp before calibration",
    "grasp, after": "grasp after calibration",
    "shadow": "compare-sim",
}


def _describe_result(step: str, row: Mapping[str, Any]) -> str:
    """Describe the result of a step in words."""
    if step.startswith("grasp"):
        means = [f"{left:+.3f}, {right:+.3f}" for left, right in row["mean_N"]]
        return (
            f"egg held {len(means)} times; mean force error (left, right), N: "
            f"{'; '.join(means)}; worst image {row['worst_N']:.3f}"
        )
    if step == "setup":
        found = "correctly assigned" if row["cameras_assigned"] else "exchanged"
        return f"{row['questions']} questions; cameras {found}"
    if "fx_px" in row:
        (true, found), (cx, found_cx) = row["fx_px"], row["cx_px"]
        return (
            f"focal length {found:.1f} px (true {true:.0f}), center {found_cx:.1f} (true {cx:.1f})"
        )
    if "young_MPa" in row:
        (young, found), (stretch, found_stretch) = row["young_MPa"], row["pre_stretch"]
        quick, found_quick = row["quick_over_lasting_less_1"]
        return (
            f"modulus {found:.2f} MPa (true long-term value {young:.2f}), pre-stretch "
            f"{found_stretch:.3f} (true {stretch:.3f}), {found_quick:.0%} relaxation within the "
            f"recording (true {quick:.0%} in 1000 s)"
        )
    return row.get("verdict", "passed")
