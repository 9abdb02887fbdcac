"""Statistics of columns for normalization: range, mean, standard deviation and quantiles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mjtactile.core.types import Array

_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}


def of_numbers(values: Array) -> dict[str, Any]:
    """Compute the statistics of each column of (n, k) values without unknown ones; null if all."""
    known = np.isfinite(values)
    filled = np.where(known.any(axis=0), values, 0.0)
    found = {
        "min": np.nanmin(filled, axis=0),
        "max": np.nanmax(filled, axis=0),
        "mean": np.nanmean(filled, axis=0),
        "std": np.nanstd(filled, axis=0),
        **{name: np.nanquantile(filled, q, axis=0) for name, q in _QUANTILES.items()},
    }
    unknown = np.atleast_1d(~known.any(axis=0))
    return {
        name: [None if bad else float(v) for v, bad in zip(value, unknown, strict=True)]
        for name, value in found.items()
    } | {"count": [len(values)]}


def of_images(values: Array, channels: int) -> dict[str, Any]:
    """Compute the statistics of (n, h, w) gray levels 0-1, in the shape (channels, 1, 1)."""
    found = {
        "min": values.min(),
        "max": values.max(),
        "mean": values.mean(),
        "std": values.std(),
        **{name: np.quantile(values, q) for name, q in _QUANTILES.items()},
    }
    return {name: [[[float(value)]]] * channels for name, value in found.items()} | {
        "count": [len(values)]
    }


def combine(stats: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Combine the episodes' statistics, weighted by their frames; quantiles are their mean."""

    def join(key: str) -> dict[str, Any]:
        parts = [stat[key] for stat in stats]
        count = np.array([part["count"][0] for part in parts], float)

        def stack(name: str) -> Array:
            return np.array([part[name] for part in parts], float)  # null becomes NaN

        mean = stack("mean")
        std = stack("std")
        shape = (-1, *[1] * (stack("mean").ndim - 1))
        weight = np.where(np.isfinite(mean), count.reshape(shape), 0.0)
        total = np.maximum(weight.sum(axis=0), 1.0)
        average = (np.nan_to_num(mean) * weight).sum(axis=0) / total
        spread = np.sqrt(
            (weight * (np.nan_to_num(std) ** 2 + (np.nan_to_num(mean) - average) ** 2)).sum(axis=0)
            / total
        )
        found = {
            "min": np.fmin.reduce(stack("min")),
            "max": np.fmax.reduce(stack("max")),
            "mean": average,
            "std": spread,
        }
        found |= {
            name: (np.nan_to_num(stack(name)) * weight).sum(axis=0) / total for name in _QUANTILES
        }
        none = weight.sum(axis=0) == 0
        return {name: np.where(none, np.nan, value).tolist() for name, value in found.items()} | {
            "count": [int(count.sum())]
        }

    return {key: join(key) for key in stats[0]}
