"""Exploring on a simulated stage, and how true what was found is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Array
from mjtactile.explore.patch import Patch
from mjtactile.explore.run import Explored, Wanted, explore
from mjtactile.explore.score import score
from mjtactile.explore.stage import Stage
from mjtactile.sim.scenes.objects import load_object
from mjtactile.sim.true_surface import TrueSurface

_ASIDE = 3e-3  # m: an object is held so far from the holder's origin, along each axis
_GENTLE = 0.5  # of the force that breaks it, at most


def explore_on_stage(
    scenario: Scenario, wanted: Wanted, *, known: Sequence[Patch] = (), **told: Any
) -> tuple[Explored, dict[str, Any]]:
    """Explore a simulated object.

    Args:
        scenario: Its object, sensor and seed, which says how the object lies in its holder.
        wanted: When to stop.
        known: Patches from before.
        told: `say`, `keep`, `stopped` as `explore` takes them.

    Returns:
        What was found, and how true it is.

    Raises:
        InputError: For names, an object that no holder holds, a force that may break it.
    """
    model = load_object(scenario.object)
    if wanted.force > _GENTLE * model.break_force:
        raise InputError(
            f"{wanted.force:g} N is more than half of the {model.break_force:g} N that break "
            f"{model.name!r}",
            field="--force-N",
        )
    p_HO, R_HO = placed(scenario.seed)
    stage = Stage(scenario.design(), model, p_HO=p_HO, R_HO=R_HO, seed=scenario.seed)
    found = explore(stage, wanted, known=known, begun=len(known), **told)
    if not found.patches:
        return found, {}
    return found, score(found, TrueSurface.of(model), p_HO, R_HO)


def placed(seed: int) -> tuple[Array, Array]:
    """How an object lies in its holder: p_HO (3,) m and R_HO (3, 3)."""
    rng = np.random.default_rng([seed, 31])
    return rng.uniform(-_ASIDE, _ASIDE, 3), Rotation.random(rng=rng).as_matrix()
