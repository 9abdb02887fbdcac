"""Edges, corners and two balls together for `bench touch`, without and with the contact shape.

The shape is that of `StatefulPipeline.shape`. The indenters are those of `bench shape`, with other
seeds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.shape.random_indenters import Case, sample_case
from mjtactile.core.types import Array, Touch
from mjtactile.experiments.test_bench import View
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.indentation import PressWorld

INDENTERS = {"wedge": "an edge", "corner": "a corner", "two balls": "two balls at once"}
FIRST_SEED = 1200
_EACH, _EACH_QUICK = 3, 1
_DEPTHS = (0.8e-3, 1.6e-3, 2.6e-3)
_DRAG = 1e-3  # maximum drag at the maximum depth, m
_MAX_FORCE = 1.5  # force limit, N
_FRAMES = 3  # images of each state; the last one counts


def indenters(*, quick: bool = False) -> list[tuple[int, Case]]:
    """Return the seeds and indenters.

    Args:
        quick: One of each kind instead of three.

    Returns:
        The same number of each kind.
    """
    each = _EACH_QUICK if quick else _EACH
    sampled = [(seed, sample_case(seed)) for seed in range(FIRST_SEED, FIRST_SEED + 9 * each)]
    return [(seed, case) for seed, case in sampled if case.name in INDENTERS]


def episode(
    seed: int, case: Case, world: PressWorld, views: Mapping[str, View]
) -> list[dict[str, Any]]:
    """Press in steps, then drag.

    Args:
        seed: Seed of the indenter.
        case: Indenter.
        world: Scene with the indenter over the sensor.
        views: View of each sensor, with its references.

    Returns:
        A row for each state and sensor.
    """
    finders = {
        name: view.perception.pipeline.make_shape_estimator(view.perception.state)
        for name, view in views.items()
    }
    drag = float(np.random.default_rng([seed, 79]).uniform(-_DRAG, _DRAG))
    rows = []
    reached = 0.0
    for depth in _DEPTHS:
        world.press(depth)
        if -ground_truth.contact_force(world, 0)[2] > _MAX_FORCE:
            break
        reached = depth
        rows += _estimates(world, views, finders)
    world.press(reached, drag)
    rows += _estimates(world, views, finders)
    return [{"seed": seed, "body": case.name, **row} for row in rows]


def _estimates(
    world: PressWorld, views: Mapping[str, View], finders: Mapping[str, Any]
) -> list[dict[str, Any]]:
    true = ground_truth.contact_wrench(world, 0)
    rows = []
    for name, view in views.items():
        perception = view.perception
        touch = estimated = None
        for _ in range(_FRAMES):
            image = view.image()
            before = perception.state
            touch = perception.perceive(image, image.time)
            estimated, perception.state = perception.pipeline.track_contact_shape(
                before, perception.state, touch, finders[name]
            )
        assert touch is not None and estimated is not None and estimated.shape is not None
        entries = {"sensor": name, "force_true_N": -float(true[2]), "kind": estimated.shape.kind}
        rows.append(entries | _against(touch, true, "") | _against(estimated, true, "_shape"))
    return rows


def _against(touch: Touch, true: Array, suffix: str) -> dict[str, float]:
    """Return the normal force error, N, and chi-square of the wrench over its six components."""
    traction = touch.traction
    assert traction is not None
    off = traction.wrench - true
    chi2 = float(off @ np.linalg.solve(traction.wrench_cov, off)) / len(off)
    return {f"error{suffix}_N": -float(off[2]), f"chi2{suffix}": chi2}


def summary(name: str, rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """Summarize the results of one sensor.

    Args:
        name: Name of the sensor.
        rows: Rows of all sensors and indenters.

    Returns:
        For each kind of indenter: mean and worst error of the normal force, and mean chi-square,
        without and with the estimated shape.
    """
    entries = {}
    for kind in INDENTERS:
        own = [row for row in rows if (row["sensor"], row["body"]) == (name, kind)]
        numbers: dict[str, float] = {}
        for suffix in ("", "_shape"):
            off = np.abs([row[f"error{suffix}_N"] for row in own])
            numbers[f"mae{suffix}_N"] = float(off.mean())
            numbers[f"worst{suffix}_N"] = float(off.max())
            numbers[f"chi2{suffix}"] = float(np.mean([row[f"chi2{suffix}"] for row in own]))
        entries[kind] = numbers
    return entries


def lines(sensors: Mapping[str, Mapping[str, dict[str, float]]]) -> list[str]:
    """Return the table.

    Args:
        sensors: Result of `summary` for each sensor.

    Returns:
        Markdown.
    """
    rows = [
        f"| normal force error (worst), N; chi-square of the wrench | {' | '.join(sensors)} |",
        "|---" * (1 + len(sensors)) + "|",
    ]
    for kind, name in INDENTERS.items():
        for suffix, label in (("", ""), ("_shape", ", with contact shape")):
            shown = [
                f"{s[kind][f'mae{suffix}_N']:.4f} ({s[kind][f'worst{suffix}_N']:.3f}), "
                f"{s[kind][f'chi2{suffix}']:.2f}"
                for s in sensors.values()
            ]
            rows.append(f"| {name}{label} | " + " | ".join(shown) + " |")
    return rows
