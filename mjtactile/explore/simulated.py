"""Exploration on a simulated stage or gripper, and its ground-truth error."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from mjtactile.core.errors import InputError
from mjtactile.core.flags import Flag, merge_flags
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Array
from mjtactile.explore.exploration import ExplorationGoal, ExplorationResult, explore, explored
from mjtactile.explore.grip_scan import HEIGHTS, GripController, Log, patches_of_grip, require_two
from mjtactile.explore.meshing import mesh_of
from mjtactile.explore.next_best_touch import Mesh
from mjtactile.explore.object_size import principal_sizes
from mjtactile.explore.stage import SimulatedStage
from mjtactile.explore.surface_fusion import fuse
from mjtactile.explore.surface_patch import Patch
from mjtactile.rig.domain_randomization import ObjectChange, SampledWorld
from mjtactile.rig.file import load_sim_rig
from mjtactile.runtime.session import Session
from mjtactile.sim.rig import build_sim_rig
from mjtactile.sim.scenes.objects import ObjectModel, load_object
from mjtactile.sim.true_surface import TrueSurface

_ASIDE = 3e-3  # maximum offset of an object from the holder's origin, along each axis, m
TURNS = tuple(math.radians(turn) for turn in (0, 90, 45, 135, 22.5, 67.5, 112.5, 157.5))
_PLAN_EDGE = 2e-3  # triangle edge during exploration, m
_FINGER = 6e-3  # contact radius around a finger's axis, m
_FACES = 0.6  # minimum cosine between a finger's axis and a contact normal
_GRIP_TIME = 30.0  # time limit of a grip, s
_GENTLE = 0.5  # maximum fraction of the breaking force
_FACETS = 5e-5  # reduction of a size by flat triangles, m
_TOUCHED_SD = 3e-5  # error of the triangulation itself, m
_PLANE_DISTANCE_MIN = 2e-3  # distance to the nearest vertex above which the plane is not used, m


def explore_on_stage(
    scenario: Scenario, goal: ExplorationGoal, *, known: Sequence[Patch] = (), **callbacks: Any
) -> tuple[ExplorationResult, dict[str, Any]]:
    """Explore a simulated object.

    Args:
        scenario: Object, sensor and seed; the seed defines the object pose in its holder.
        goal: Stop criteria.
        known: Patches from earlier touches.
        callbacks: `say`, `keep`, `stopped`; see `explore`.

    Returns:
        The result and its ground-truth error.

    Raises:
        InputError: Unknown names, an object that does not fit a holder, or a force that may break
            it.
    """
    model = _load_object(scenario, goal)
    p_HO, R_HO = object_pose(scenario.seed)
    stage = SimulatedStage(scenario.design(), model, p_HO=p_HO, R_HO=R_HO, seed=scenario.seed)
    found = explore(stage, goal, known=known, completed=len(known), **callbacks)
    if not found.patches:
        return found, {}
    return found, score(found, TrueSurface.of(model), p_HO, R_HO)


def _load_object(scenario: Scenario, goal: ExplorationGoal) -> ObjectModel:
    """Return the object. Raises InputError if the force may break it."""
    model = load_object(scenario.object)
    if goal.force > _GENTLE * model.break_force:
        raise InputError(
            f"{goal.force:g} N is more than half of the breaking force of {model.name!r}, "
            f"{model.break_force:g} N",
            field="--force-N",
        )
    return model


def object_pose(seed: int) -> tuple[Array, Array]:
    """Return the pose of an object in its holder: p_HO (3,), m, and R_HO (3, 3)."""
    rng = np.random.default_rng([seed, 31])
    return rng.uniform(-_ASIDE, _ASIDE, 3), Rotation.random(rng=rng).as_matrix()


def explore_in_gripper(
    scenario: Scenario,
    goal: ExplorationGoal,
    *,
    known: Sequence[Patch] = (),
    notify: Callable[[str], None] = lambda _: None,
    keep: Callable[[Patch], None] = lambda _: None,
    stopped: Callable[[], bool] = lambda: False,
) -> tuple[ExplorationResult, dict[str, Any]]:
    """Grip a simulated object at several heights and rotations.

    Args:
        scenario: Object, sensor, rig (two fingers) and seed.
        goal: Stop criteria; a grip counts as one touch.
        known: Patches from earlier grips.
        notify: Callback that receives a line for each grip.
        keep: Callback that receives each patch.
        stopped: Callback that returns True to stop.

    Returns:
        The result and its ground-truth error.

    Raises:
        InputError: Unknown names, a rig that is not simulated, or a force that may break the
            object.
    """
    model = _load_object(scenario, goal)
    require_two(len(load_sim_rig(scenario.rig).fingers))
    patches = list(known)
    grip_number = max((patch.group for patch in patches), default=0)
    grips: list[tuple[float, float]] = []
    hypotheses = fuse(patches)
    flags: dict[str, Flag] = {}
    outcome = "touches"
    while grip_number < goal.touches:
        mesh = mesh_of(hypotheses[0], _PLAN_EDGE)
        if patches and mesh.error() <= goal.accuracy:
            outcome = "accurate"
            break
        if stopped():
            outcome = "interrupted"
            break
        angle, height = next_grip(mesh, grips, has_contact=bool(patches))
        grips.append((angle, height))
        grip_number += 1
        new = _grip(scenario, angle, height, goal.force, grip_number, flags)
        for patch in new:
            keep(patch)
        patches += new
        hypotheses = fuse(patches, hypotheses)
        sd = 1e3 * mesh_of(hypotheses[0], _PLAN_EDGE).error()
        kinds = ", ".join(patch.kind for patch in new) or "no contact"
        notify(
            f"grip {grip_number}: rotated {math.degrees(angle):.0f} deg, {1e3 * height:.0f} mm up: "
            f"{kinds}; surface sd {sd:.2f} mm"
        )
    found = explored(patches, outcome if patches else "no contact", grip_number, flags)
    if not patches:
        return found, {}
    return found, score(found, TrueSurface.of(model), np.zeros(3), np.eye(3))


def next_grip(
    mesh: Mesh, grips: Sequence[tuple[float, float]], *, has_contact: bool
) -> tuple[float, float]:
    """Choose rotation, rad, and height, m, of a grip, so that the fingers meet the most uncertain
    part of the surface. Before the first contact the rotations are tried in order."""
    if not has_contact:
        return TURNS[len(grips) % len(TURNS)], HEIGHTS[0]
    worth = {}
    for angle, height in itertools.product(TURNS, HEIGHTS):
        if (angle, height) in grips:
            continue
        axis = np.array([math.cos(angle), -math.sin(angle), 0.0])
        centered = mesh.vertices - (0.0, 0.0, height)
        along = centered @ axis
        lateral = np.linalg.norm(centered - along[:, None] * axis, axis=1)
        near = (lateral < _FINGER) & (np.abs(mesh.normals @ axis) > _FACES)
        worth[angle, height] = float(mesh.sd[near].mean()) if near.sum() > 8 else 0.0
    return max(worth, key=lambda grip: worth[grip]) if worth else grips[0]


def _grip(
    scenario: Scenario,
    turn: float,
    height: float,
    force: float,
    grip_number: int,
    flags: dict[str, Flag],
) -> list[Patch]:
    """Simulate one grip of the rotated object."""
    # a seed first samples the camera noise, so each grip gets its own seed
    file = load_sim_rig(scenario.rig)
    change = SampledWorld(object=ObjectChange(place=(0.0, 0.0), yaw=turn))
    rig = build_sim_rig(
        replace(scenario, seed=scenario.seed + grip_number), file=file, sampled=change
    )
    log = Log()
    try:
        session = Session(rig, threads=0)
        session.take_references()
        session.run(GripController((height,), force), time_limit=_GRIP_TIME, observer=log)
        flags |= merge_flags((flags, session.flags))
        designs = [finger.design for finger in rig.fingers]
        return patches_of_grip(
            log.cycles, session.perceptions, designs, yaw=turn, group=grip_number
        )
    finally:
        rig.close()


def score(
    found: ExplorationResult, true: TrueSurface, p_HO: Array, R_HO: Array
) -> dict[str, float]:
    """Compare an explored surface with the true surface of the object at its true pose.

    Returns:
        `surface_error_mm_true` (root mean square of the distances from either surface to the
        other), `surface_error_95_mm_true` (95 % quantile), `size_error_true` (largest relative
        error of three extents along the object's axes), `within_1_sd_true`, `within_2_sd_true`
        (fractions of the estimated surface), `sizes_within_true` (fraction of the three estimated
        sizes whose 68 % interval contains the true one), `sizes_within_2_sd_true`.
    """
    mesh = found.mesh
    vertices = (mesh.vertices - p_HO) @ R_HO
    normals = mesh.normals @ R_HO
    weights = mesh.areas()
    outside = true.off(vertices, normals)
    missed = _missed(Mesh(vertices, mesh.triangles, normals, mesh.sd), true.points)
    square = (np.average(outside**2, weights=weights) + float(np.mean(missed**2))) / 2
    sizes = np.ptp(vertices, axis=0) / true.extents(np.eye(3))
    sd = np.maximum(mesh.sd, _TOUCHED_SD)
    both = np.concatenate([np.abs(outside), np.abs(missed)])
    return {
        "surface_error_mm_true": 1e3 * float(np.sqrt(square)),
        "surface_error_95_mm_true": 1e3 * float(np.quantile(both, 0.95)),
        "size_error_true": float(np.abs(sizes - 1).max()),
        "within_1_sd_true": float(np.average(np.abs(outside) < sd, weights=weights)),
        "within_2_sd_true": float(np.average(np.abs(outside) < 2 * sd, weights=weights)),
        **_sizes_within(found, true, R_HO),
    }


def _sizes_within(found: ExplorationResult, surface: TrueSurface, R_HO: Array) -> dict[str, float]:
    """Return the fraction of sizes within their intervals, and within twice their sd. The sizes are
    along the estimated axes. A tolerance of 0.05 mm covers the triangulation error."""
    _, axes = principal_sizes(found.mesh)
    true = surface.extents(R_HO.T @ axes)
    low, high = found.sizes.interval.T
    twice = np.abs(true - found.sizes.mean) <= 2 * found.sizes.sd + _FACETS
    return {
        "sizes_within_true": float(np.mean((true >= low - _FACETS) & (true <= high + _FACETS))),
        "sizes_within_2_sd_true": float(np.mean(twice)),
    }


def _missed(mesh: Mesh, points: Array) -> Array:
    """Return the distances of true points from the estimated surface, (N,) m. The distance is to
    the plane of the nearest vertex, or to that vertex if it is far away."""
    distance, nearest = KDTree(mesh.vertices).query(points)
    across = np.einsum("ni,ni->n", points - mesh.vertices[nearest], mesh.normals[nearest])
    return np.where(distance < _PLANE_DISTANCE_MIN, across, distance)
