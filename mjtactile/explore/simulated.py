"""Exploration on a simulated stage or gripper, and its ground-truth error."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Array
from mjtactile.explore.exploration import ExplorationGoal, ExplorationResult, explore, explored
from mjtactile.explore.grip_scan import HEIGHTS, GripController, Log, patches_of_grip, require_two
from mjtactile.explore.ground_truth_error import score
from mjtactile.explore.meshing import mesh_of
from mjtactile.explore.next_best_touch import Mesh
from mjtactile.explore.stage import SimulatedStage
from mjtactile.explore.surface_fusion import fuse
from mjtactile.explore.surface_patch import Patch
from mjtactile.rig.domain_randomization import Drawn, ObjectChange
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


def explore_on_stage(
    scenario: Scenario, wanted: ExplorationGoal, *, known: Sequence[Patch] = (), **told: Any
) -> tuple[ExplorationResult, dict[str, Any]]:
    """Explore a simulated object.

    Args:
        scenario: Object, sensor and seed; the seed defines the object pose in its holder.
        wanted: Stop criteria.
        known: Patches from earlier touches.
        told: `say`, `keep`, `stopped`; see `explore`.

    Returns:
        The result and its ground-truth error.

    Raises:
        InputError: Unknown names, an object that does not fit a holder, or a force that may break
            it.
    """
    model = _checked(scenario, wanted)
    p_HO, R_HO = placed(scenario.seed)
    stage = SimulatedStage(scenario.design(), model, p_HO=p_HO, R_HO=R_HO, seed=scenario.seed)
    found = explore(stage, wanted, known=known, begun=len(known), **told)
    if not found.patches:
        return found, {}
    return found, score(found, TrueSurface.of(model), p_HO, R_HO)


def _checked(scenario: Scenario, wanted: ExplorationGoal) -> ObjectModel:
    """The object, where the force cannot break it."""
    model = load_object(scenario.object)
    if wanted.force > _GENTLE * model.break_force:
        raise InputError(
            f"{wanted.force:g} N is more than half of the breaking force of {model.name!r}, "
            f"{model.break_force:g} N",
            field="--force-N",
        )
    return model


def placed(seed: int) -> tuple[Array, Array]:
    """Return the pose of an object in its holder: p_HO (3,), m, and R_HO (3, 3)."""
    rng = np.random.default_rng([seed, 31])
    return rng.uniform(-_ASIDE, _ASIDE, 3), Rotation.random(rng=rng).as_matrix()


def explore_in_gripper(
    scenario: Scenario,
    wanted: ExplorationGoal,
    *,
    known: Sequence[Patch] = (),
    say: Callable[[str], None] = lambda _: None,
    keep: Callable[[Patch], None] = lambda _: None,
    stopped: Callable[[], bool] = lambda: False,
) -> tuple[ExplorationResult, dict[str, Any]]:
    """Grip a simulated object at several heights and rotations.

    Args:
        scenario: Object, sensor, rig (two fingers) and seed.
        wanted: Stop criteria; a grip counts as one touch.
        known: Patches from earlier grips.
        say: Callback that receives a line for each grip.
        keep: Callback that receives each patch.
        stopped: Callback that returns True to stop.

    Returns:
        The result and its ground-truth error.

    Raises:
        InputError: Unknown names, a rig that is not simulated, or a force that may break the
            object.
    """
    model = _checked(scenario, wanted)
    require_two(len(load_sim_rig(scenario.rig).fingers))
    patches = list(known)
    number = max((patch.group for patch in patches), default=0)
    tried: list[tuple[float, float]] = []
    believed = fuse(patches)
    flags: dict[str, str] = {}
    outcome = "touches"
    while number < wanted.touches:
        mesh = mesh_of(believed[0], _PLAN_EDGE)
        if patches and mesh.error() <= wanted.accuracy:
            outcome = "accurate"
            break
        if stopped():
            outcome = "interrupted"
            break
        turn, height = next_grip(mesh, tried, bool(patches))
        tried.append((turn, height))
        number += 1
        new = _grip(scenario, turn, height, wanted.force, number, flags)
        for patch in new:
            keep(patch)
        patches += new
        believed = fuse(patches, believed)
        doubt = 1e3 * mesh_of(believed[0], _PLAN_EDGE).error()
        kinds = ", ".join(patch.kind for patch in new) or "nothing felt"
        say(
            f"grip {number}: rotated {math.degrees(turn):.0f} deg, {1e3 * height:.0f} mm up: "
            f"{kinds}; surface sd {doubt:.2f} mm"
        )
    found = explored(patches, outcome if patches else "nothing there", number, flags)
    if not patches:
        return found, {}
    return found, score(found, TrueSurface.of(model), np.zeros(3), np.eye(3))


def next_grip(mesh: Mesh, tried: Sequence[tuple[float, float]], begun: bool) -> tuple[float, float]:
    """Choose rotation, rad, and height, m, of a grip, so that the fingers meet the most uncertain
    part of the surface. Before the first contact the rotations are tried in order."""
    if not begun:
        return TURNS[len(tried) % len(TURNS)], HEIGHTS[0]
    worth = {}
    for turn in TURNS:
        axis = np.array([math.cos(turn), -math.sin(turn), 0.0])
        for height in HEIGHTS:
            if (turn, height) in tried:
                continue
            off = mesh.vertices - (0.0, 0.0, height)
            along = off @ axis
            aside = np.linalg.norm(off - along[:, None] * axis, axis=1)
            near = (aside < _FINGER) & (np.abs(mesh.normals @ axis) > _FACES)
            worth[turn, height] = float(mesh.sd[near].mean()) if near.sum() > 8 else 0.0
    if not worth:
        return tried[0]
    return max(worth, key=lambda grip: worth[grip])


def _grip(
    scenario: Scenario, turn: float, height: float, force: float, number: int, flags: dict[str, str]
) -> list[Patch]:
    """Simulate one grip of the rotated object."""
    # a seed first samples the camera noise, so each grip gets its own seed
    file = load_sim_rig(scenario.rig)
    drawn = Drawn(object=ObjectChange(place=(0.0, 0.0), yaw=turn))
    rig = build_sim_rig(replace(scenario, seed=scenario.seed + number), file=file, drawn=drawn)
    log = Log()
    try:
        session = Session(rig, threads=0)
        session.take_references()
        session.run(GripController((height,), force), time_limit=_GRIP_TIME, observer=log)
        flags |= dict(rig.flags())
        designs = [finger.design for finger in rig.fingers]
        return patches_of_grip(log.moments, session.perceptions, designs, yaw=turn, group=number)
    finally:
        rig.close()
