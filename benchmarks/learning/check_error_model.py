"""Comparison of a sensing pipeline's errors with errors sampled from a model of them."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np

from mjtactile.core.types import Array
from mjtactile.sim.sensing_error_model import SensingErrorModel


def check(errors: SensingErrorModel, rows: dict[str, Array]) -> dict[str, Any]:
    """Compare errors of other seeds with the model.

    At each load, over all grasps, compute the rms error over the model's standard deviation (1: as
    modeled).
    """
    load = np.maximum(-rows["wrench"][:, 2], 0.0)
    known = np.asarray(rows["status"] == "ok")
    left = rows["estimated"] - rows["wrench"] @ (np.eye(6) + errors.gain).T
    at = [errors.at(float(item)) for item in load]
    z = (left - [item.mean for item in at]) / [item.sd for item in at]
    by_load = []
    for low, high in pairwise(errors.loads.tolist()):
        here = known & (load >= low) & (load < high)
        by_load.append(
            {
                "from_N": low,
                "to_N": high,
                "images": int(here.sum()),
                "force_rms_mN": 1e3 * _rms(rows["estimated"][here, 2] - rows["wrench"][here, 2]),
                "sampled_rms_mN": 1e3 * _rms(_sampled(errors, rows["wrench"][here])),
                "force_ratio": _rms(z[here, 2]),
                "shear_ratio": _rms(z[here, :2]),
                "torque_ratio": _rms(z[here, 3:]),
            }
        )
    return {"rows": by_load, "unknown_percent": 100 * float(np.mean(~known))}


def _sampled(errors: SensingErrorModel, wrenches: Array) -> Array:
    """Sample an error of the normal force, N, for each wrench (n, 6); return (n,)."""
    rng = np.random.default_rng(0)
    found = []
    for wrench in wrenches:
        here = errors.at(max(-float(wrench[2]), 0.0))
        error = here.sd[2] * rng.standard_normal()
        found.append(errors.gain[2] @ wrench + here.mean[2] + error)
    return np.array(found)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if np.size(values) else math.nan
