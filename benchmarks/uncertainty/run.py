"""`mjtactile bench uncertainty`: 10^4 images of random scenes, wrench errors in units of their
standard deviations.

Scenes are presses, drags, taps, holds, near the frame, shaken. They use three layouts at two
resolutions and three meshes. Seeds below FIRST_SEED were used in tuning and are excluded. Each
scene's rows are stored in a separate file; `--resume` continues from there.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.uncertainty.evaluate_scene import Sample, watch
from benchmarks.uncertainty.scenes import sample_scene
from benchmarks.uncertainty.tables import summary, table
from mjtactile.core.errors import SimulationError
from mjtactile.core.status import OK
from mjtactile.recording.files import write_json

__all__ = ["run", "table"]
FIRST_SEED = 1000
SCENES = 260
SCENES_QUICK = 4

Notify = Callable[[str], None]


def run(
    out: Path, *, quick: bool = False, resume: bool = False, notify: Notify = lambda _: None
) -> dict[str, Any]:
    """Evaluate the scenes and return the JSON object.

    It has no rows; these are in `out`/scenes.
    """
    folder = out / "scenes"
    folder.mkdir(parents=True, exist_ok=True)
    seeds = range(FIRST_SEED, FIRST_SEED + (SCENES_QUICK if quick else SCENES))
    files = {seed: folder / f"{seed}.json" for seed in seeds}
    with ProcessPoolExecutor(max_workers=1 if quick else os.cpu_count()) as pool:
        waiting = [seed for seed in seeds if not (resume and files[seed].is_file())]
        for found in pool.map(scene_rows, waiting):
            write_json(files[found["seed"]], found)
            notify(
                f"{found['seed']} {found['kind']} of a {found['shape']}, {found['sensor']}: "
                + (found["error"] or f"{len(found['rows'])} images")
            )
    return summary([json.loads(file.read_text(encoding="utf-8")) for file in files.values()])


def scene_rows(seed: int) -> dict[str, Any]:
    """Evaluate one scene; return its description, and a row for each image."""
    scene = sample_scene(seed)
    about = {
        "seed": seed,
        "kind": scene.kind,
        "shape": scene.shape,
        "sensor": scene.sensor,
        "mesh": list(scene.mesh),
    }
    try:
        watched = watch(scene)
    except SimulationError as error:
        return about | {"rows": [], "flags": [], "error": " ".join(str(error).split())}
    return about | {
        "rows": [_row(sample) for sample in watched.samples],
        "flags": sorted(watched.flags),
        "error": "",
    }


def _row(sample: Sample) -> dict[str, Any]:
    touch = sample.touch
    traction = sample.touch.traction
    known = touch.status == OK
    estimated = (
        touch.contact.area
        if known and touch.contact is not None and len(touch.patches) == 1
        else None
    )
    return {
        "time": touch.time,
        "status": str(touch.status.code),
        "touching": touch.touching,
        "rattles": sample.rattles,
        "wrench_true": sample.wrench.tolist(),
        "wrench": traction.wrench.tolist() if known and traction else None,
        "sd": np.sqrt(np.diag(traction.wrench_cov)).tolist() if known and traction else None,
        "area_true": sample.area,
        "area": estimated,
    }
