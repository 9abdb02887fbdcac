"""`mjtactile bench explore`: error of surfaces fused from twelve touches on a simulated stage.

Objects are the shipped egg, vial, block and strawberry, and random objects (`random:SEED`). The
seed sets the pose of each in its holder. Development used pose seeds below FIRST_SEED, and no
random object.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.errors import MjtactileError
from mjtactile.core.scenario import Scenario
from mjtactile.explore.exploration import ExplorationGoal, explored
from mjtactile.explore.simulated import explore_on_stage, object_pose, score
from mjtactile.explore.surface_patch import Patch
from mjtactile.recording.files import to_json
from mjtactile.runtime.progress import Progress
from mjtactile.sim.scenes.objects import load_object
from mjtactile.sim.true_surface import TrueSurface

FIRST_SEED = 500
SHIPPED = ("egg", "vial", "block", "strawberry")
POSES = 2
RANDOM = ("random:501", "random:502", "random:503", "random:504", "random:505", "random:506")
TOUCHES = 12
FORCE = 0.3  # contact force of a touch, N
ACCURATE = 0.7  # required surface error, mm


@dataclass(frozen=True)
class Case:
    """An object and the seed of its pose."""

    name: str
    seed: int


def run(out: Path, quick: bool = False, resume: bool = False) -> dict[str, Any]:
    """Explore each object; each takes about a minute of a processor.

    Args:
        out: Folder of `explore_rows.jsonl`.
        quick: Only an egg, with four touches.
        resume: Keep the stored rows.

    Returns:
        "rows", one per exploration.
    """
    notify = Progress().message
    path = out / "explore_rows.jsonl"
    rows = _kept(path) if resume else []
    if not resume:
        path.unlink(missing_ok=True)
    for case in _cases(quick):
        if any((row["object"], row["seed"]) == (case.name, case.seed) for row in rows):
            continue
        row = _explored(case, 4 if quick else TOUCHES)
        rows.append(row)
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(to_json(row)) + "\n")
        notify(_words(row))
    return {"rows": rows}


def _kept(path: Path) -> list[dict[str, Any]]:
    if not path.is_file():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def _cases(quick: bool) -> list[Case]:
    if quick:
        return [Case("egg", FIRST_SEED)]
    shipped = [Case(name, FIRST_SEED + pose) for pose in range(POSES) for name in SHIPPED]
    return [*shipped, *(Case(name, FIRST_SEED + k) for k, name in enumerate(RANDOM))]


def _explored(case: Case, touches: int) -> dict[str, Any]:
    start = time.process_time()
    names = {"object": case.name, "seed": case.seed}
    patches: list[Patch] = []
    counts: list[int] = []
    try:
        found, true = explore_on_stage(
            Scenario(object=case.name, seed=case.seed),
            ExplorationGoal(touches, force=FORCE),
            keep=patches.append,
            notify=lambda _: counts.append(len(patches)),
        )
    except MjtactileError as error:
        return names | {"failed": " ".join(str(error).split())}
    reported = found.summary()
    kept = {
        name: reported[name]
        for name in (
            "touches",
            "patches",
            "body",
            "surface_sd_mm",
            "size_mm",
            "size_sd_mm",
            "failures",
            "stiffness_N_m",
        )
    }
    forces = [patch.force for patch in found.patches]
    seconds = time.process_time() - start
    return {
        **names,
        **kept,
        **true,
        "force_max_N": max(forces, default=float("nan")),
        "seconds": seconds,
        "errors_by_touch_mm": [_error_of(case, patches[:count]) for count in counts],
    }


def _error_of(case: Case, patches: list[Patch]) -> float:
    """Return the surface error of these patches, mm; infinite without any."""
    if not patches:
        return math.inf
    found = explored(patches, "touches", len(patches), {})
    true = TrueSurface.of(load_object(case.name))
    return score(found, true, *object_pose(case.seed))["surface_error_mm_true"]


def touches_to(errors: Sequence[float | None], limit: float) -> int:
    """Return the number of touches from which no error exceeds `limit` (None: no surface yet); one
    more than all if the last one does."""
    above = (n for n, error in enumerate(errors, 1) if error is None or error > limit)
    return max(above, default=0) + 1


def _words(row: Mapping[str, Any]) -> str:
    if "failed" in row:
        return f"{row['object']} {row['seed']}: failed: {row['failed']}"
    return (
        f"{row['object']} {row['seed']}: off by {row['surface_error_mm_true']:.2f} mm, size by "
        f"{100 * row['size_error_true']:.1f} %"
    )


def table(result: Mapping[str, Any]) -> str:
    """Format the result as a Markdown table."""
    rows = result["rows"]
    lines = [
        "| object, pose | shape model | surface error, rms (95 %), mm | size error, largest of "
        "three, % | sizes within 68 % (2 sd) | estimated error, mm | within 1 (2) sd, % | touches "
        f"to {ACCURATE:g} mm |",
        "|---" * 8 + "|",
        "| required | | 0.7 (target 0.3) | 3 (target 1) | 2 of 3 (3) | | 68 (95) | 9 (target 7) |",
    ]
    lines += [_line(row) for row in rows]
    good = [row for row in rows if "failed" not in row]
    for label, chosen in (
        ("shipped objects", [row for row in good if row["object"] in SHIPPED]),
        ("random objects", [row for row in good if row["object"] not in SHIPPED]),
    ):
        if chosen:
            error, size = (
                float(np.median([row[name] for row in chosen]))
                for name in ("surface_error_mm_true", "size_error_true")
            )
            lines.append(_median(label, chosen, error, size))
    if good:
        force = max(row["force_max_N"] for row in good)
        seconds = float(np.median([row["seconds"] for row in good]))
        counts = [touches_to(row["errors_by_touch_mm"], ACCURATE) for row in good]
        lines += [
            "",
            f"All objects: {np.median(counts):g} touches to {ACCURATE:g} mm in the median; sizes "
            f"within 2 % for {sum(row['size_error_true'] < 0.02 for row in good)} of {len(good)}. "
            f"Estimated forces up to {force:.2f} N; {seconds:.0f} s of a processor each.",
        ]
    return "\n".join(lines) + "\n"


def _median(label: str, rows: list[Mapping[str, Any]], error: float, size: float) -> str:
    within, twice = (
        sum(round(3 * row[name]) for row in rows)
        for name in ("sizes_within_true", "sizes_within_2_sd_true")
    )
    covered, covered_twice = (
        100 * float(np.mean([row[name] for row in rows]))
        for name in ("within_1_sd_true", "within_2_sd_true")
    )
    counts = [touches_to(row["errors_by_touch_mm"], ACCURATE) for row in rows]
    return (
        f'| **{label}: medians; columns "within": all** | | {error:.2f} | {100 * size:.1f} | '
        f"{within} of {3 * len(rows)} ({twice}) | | {covered:.0f} ({covered_twice:.0f}) | "
        f"{np.median(counts):g} |"
    )


def _line(row: Mapping[str, Any]) -> str:
    if "failed" in row:
        return f"| {row['object']} {row['seed']} | failed: {row['failed']} | | | | | | |"
    errors = row["errors_by_touch_mm"]
    count = touches_to(errors, ACCURATE)
    sizes = f"{3 * row['sizes_within_true']:.0f} of 3 ({3 * row['sizes_within_2_sd_true']:.0f})"
    places = f"{100 * row['within_1_sd_true']:.0f} ({100 * row['within_2_sd_true']:.0f})"
    return (
        f"| {row['object']} {row['seed']} | {row['body']} | "
        f"{row['surface_error_mm_true']:.2f} ({row['surface_error_95_mm_true']:.2f}) | "
        f"{100 * row['size_error_true']:.1f} | {sizes} | {row['surface_sd_mm']:.2f} | {places} | "
        f"{count if count <= len(errors) else f'> {len(errors)}'} |"
    )
