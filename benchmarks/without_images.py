"""`mjtactile bench no-images`: episodes without images against episodes with them.

Markers: the image stages and `--effects -images` process the same membranes, with references taken
alike. Position errors are given by mean, spread, outliers and dropouts. Grasps: the same episodes
(object, seed, randomization) run both ways, alternating in one process. The result is outcomes,
true hold forces, and episodes per hour of one core.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Array, Image
from mjtactile.evaluate.episodes import Episode, run_episode
from mjtactile.evaluate.wilson import wilson
from mjtactile.runtime.progress import Progress
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sim.rendering.renderer import Renderer
from mjtactile.sim.rendering.synthetic_ellipses import EllipseSampler
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

IMAGES = 100
IMAGES_QUICK = 8
PAIRS = 200
PAIRS_QUICK = 1
OBJECTS = ("egg", "strawberry", "vial")
_REFERENCES = 10  # images of a reference, as in a session
_PER_REFERENCE = 5  # images evaluated with the same references
_OUTLIER = 5.0  # limit of an outlier, in the marker's own standard deviations
_TIMESTEP = 4e-3

Pose = tuple[Array, Array]
Notify = Callable[[str], None]


@dataclass(frozen=True)
class Scene:
    """A sphere of `radius` m at `at` m is pressed in by `depth` m; `blur` px of the camera."""

    radius: float = 8e-3
    at: tuple[float, float] = (2e-3, 1e-3)
    depth: float = 2e-3
    blur: float = 0.7
    noise: float = 2.0


SCENES = {
    "at rest, sharp": Scene(depth=0.0),
    "pressed, sharp": Scene(),
    "pressed, blurred (2 px)": Scene(blur=2.0),
    "pressed, noisy (6 DN)": Scene(noise=6.0),
    "steep (39 degrees), sharp": Scene(4e-3, (14e-3, 0.4e-3), 5e-3),
    "steep, blurred (2 px)": Scene(4e-3, (14e-3, 0.4e-3), 5e-3, 2.0),
}


def run(
    out: Path, *, quick: bool = False, pairs: int | None = None, notify: Notify | None = None
) -> dict[str, Any]:
    """Measure marker errors in every scene, and compare `pairs` of episodes."""
    notify = notify or Progress().message
    rows = []
    for name, scene in SCENES.items():
        notify(f"markers: {name}")
        rows.append({"scene": name, **marker_errors(scene, IMAGES_QUICK if quick else IMAGES)})
    if pairs is None:
        pairs = PAIRS_QUICK if quick else PAIRS
    return {"markers": rows, "grasps": _grasps(list(_pairs(pairs, notify)))}


# -- markers
# --------------------------------------------------------------------------------


def marker_errors(scene: Scene, count: int) -> dict[str, Any]:
    """Compute the errors of marker positions with both methods over `count` images, um."""
    design = load_sensor("dense")
    design = replace(
        design, camera=replace(design.camera, blur_px=scene.blur, noise_dn=scene.noise)
    )
    flat, rest, pressed = _poses(design, scene)
    renderer = Renderer(design, seed=1)
    sampler = EllipseSampler(design, seed=1)
    methods: dict[str, Callable[[Pose], Image]] = {
        "images": lambda pose: renderer.render(*pose),
        "none": lambda pose: sampler.sample(*pose),
    }
    return {
        method: _errors(design, take_image, (flat, rest, pressed), count)
        for method, take_image in methods.items()
    }


def _poses(design: SensorDesign, scene: Scene) -> tuple[Pose, Pose, Pose]:
    """Return the markers of the flat, the inflated and the indented membrane."""
    world = PressWorld(design, Indenter("sphere", scene.radius), at=scene.at, timestep=_TIMESTEP)
    poses = []
    for gauge in (0.0, 1000.0):
        world.inflate(gauge, seal=gauge > 0)
        poses.append(world.marker_poses(0))
    if scene.depth:
        world.press(scene.depth)
    return poses[0], poses[1], world.marker_poses(0)


def _errors(
    design: SensorDesign, take_image: Callable[[Pose], Image], poses: Sequence[Pose], count: int
) -> dict[str, Any]:
    sensing_pipeline = SensingPipeline(design)
    state = None
    p_SM = poses[2][0]
    errors = []
    sds = []
    outliers = 0
    for k in range(count):
        if state is None or k % _PER_REFERENCE == 0:
            state = sensing_pipeline.measure_flat_reference(
                sensing_pipeline.initial_state(), [take_image(poses[0]) for _ in range(_REFERENCES)]
            )
            state = sensing_pipeline.measure_rest_reference(
                state, [take_image(poses[1]) for _ in range(_REFERENCES)], 1000.0
            )
        markers, state = sensing_pipeline.detect_markers(state, take_image(poses[2]))
        error = np.full_like(p_SM, np.nan)
        sd = np.full_like(p_SM, np.nan)
        error[markers.ids] = markers.p_SM - p_SM[markers.ids]
        sd[markers.ids] = np.sqrt(np.diagonal(markers.cov_p, axis1=1, axis2=2))
        spread = np.einsum(
            "ni,nij,nj->n", error[markers.ids], np.linalg.inv(markers.cov_p), error[markers.ids]
        )
        outliers += int((spread > _OUTLIER**2).sum())
        errors.append(error)
        sds.append(sd)
    error = np.array(errors)
    reported = np.array(sds)
    detected = int(np.isfinite(error[..., 0]).sum())
    mean = np.nanmean(error, axis=0)
    return {
        "mean_um": (1e6 * np.sqrt(np.nanmean(mean**2, axis=0))).tolist(),
        "sd_um": (1e6 * np.nanmedian(np.nanstd(error, axis=0), axis=0)).tolist(),
        "reported_sd_um": (1e6 * np.nanmedian(reported, axis=(0, 1))).tolist(),
        "outliers_percent": 100 * outliers / max(detected, 1),
        "missed_percent": 100 * (1 - detected / error[..., 0].size),
    }


# -- grasps
# --------------------------------------------------------------------------------


def _pairs(count: int, notify: Notify) -> Iterator[dict[str, Any]]:
    """Run each episode with and without images; yield its results and processor times, s."""
    for k in range(count):
        pair: dict[str, Any] = {"seed": k, "object": OBJECTS[k % len(OBJECTS)]}
        for method, effects in (("images", "auto"), ("none", "-images"))[:: 1 if k % 2 else -1]:
            start = time.process_time()
            line = run_episode(
                Episode(
                    k,
                    Scenario(
                        object=pair["object"],
                        controller="gentle",
                        seed=k,
                        effects=effects,
                        randomization="default",
                    ),
                )
            )
            pair[method] = {
                key: line[key]
                for key in ("outcome", "hold_force_N", "hold_force_true_N", "peak_force_true_N")
            }
            pair[method]["core_s"] = time.process_time() - start
        notify(
            f"grasps: {k + 1} of {count}: {pair['object']}, {pair['images']['outcome']}, "
            f"{pair['none']['outcome']}"
        )
        yield pair


def _grasps(pairs: list[dict[str, Any]]) -> dict[str, Any]:
    """Sum up the pairs; forces are compared for pairs that held the object both ways."""
    held = {
        direction: sum(pair[direction]["outcome"] == "held" for pair in pairs)
        for direction in ("images", "none")
    }
    both = [
        pair for pair in pairs if pair["images"]["outcome"] == pair["none"]["outcome"] == "held"
    ]
    differences = np.array(
        [pair["none"]["hold_force_true_N"] - pair["images"]["hold_force_true_N"] for pair in both]
    )
    mean = float(differences.mean()) if len(differences) else math.nan
    return {
        "pairs": len(pairs),
        "same_outcome": sum(p["images"]["outcome"] == p["none"]["outcome"] for p in pairs),
        "held": held,
        "held_interval": {
            direction: list(wilson(held[direction], len(pairs))) for direction in held
        },
        "force_mN": 1e3 * mean,
        "force_interval_mN": 1e3
        * 1.96
        * float(differences.std(ddof=1))
        / math.sqrt(len(differences))
        if len(differences) > 1
        else math.nan,
        "force_sd_mN": 1e3 * float(differences.std()) if len(differences) else math.nan,
        "an_hour": {
            direction: 3600 * len(pairs) / sum(pair[direction]["core_s"] for pair in pairs)
            if pairs
            else math.nan
            for direction in ("images", "none")
        },
        "rows": pairs,
    }


# -- table
# --------------------------------------------------------------------------------


def table(result: dict[str, Any]) -> str:
    """Format both comparisons in Markdown."""
    lines = [
        "| markers, um (with images / without) | mean error, rms (x, y, z) | sd (x, y, z) | "
        "beyond 5 sd, % |",
        "|---" * 4 + "|",
    ]
    for row in result["markers"]:

        def cell(key: str, row: dict[str, Any] = row) -> str:
            values = (row["images"][key], row["none"][key])
            return " / ".join(
                ", ".join(f"{v:.1f}" for v in value) if isinstance(value, list) else f"{value:.2f}"
                for value in values
            )

        cells = map(cell, ("mean_um", "sd_um", "outliers_percent"))
        lines.append(f"| {row['scene']} | {' | '.join(cells)} |")
    g = result["grasps"]
    low, high = (100 * value for value in g["held_interval"]["none"])
    lines += [
        "",
        f"{g['pairs']} episodes with and without images (`gentle`; {', '.join(OBJECTS)}; "
        f"`--randomization default`): same outcome in {g['same_outcome']}. Held: "
        f"{g['held']['images']} with images, {g['held']['none']} without (95 %: {low:.0f}-"
        f"{high:.0f} %). Mean difference of the true grip force: {g['force_mN']:+.2f} +- "
        f"{g['force_interval_mN']:.2f} mN (95 %); sd between episodes {g['force_sd_mN']:.1f} mN. "
        f"Episodes per hour of one core: {g['an_hour']['images']:.0f} with images, "
        f"{g['an_hour']['none']:.0f} without.",
    ]
    return "\n".join(lines) + "\n"
