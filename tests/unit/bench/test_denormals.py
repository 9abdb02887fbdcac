"""Denormal numbers are found wherever a chain or a camera keeps them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.speed import denormals
from mjtactile.core.design import load_sensor
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sim.rendering.renderer import Renderer, _brush


@dataclass
class ArrayHolder:
    kept: Any


ArrayHolder.__module__ = "mjtactile.keeper"


def test_counted_operations():
    tiny = (
        np.array([1e-310, -1e-310, 0.0, 1e-300, np.nan]),
        np.array([1e-40, 1e-30], np.float32),
        np.arange(3),
    )
    # the same arrays count once
    assert denormals.count(ArrayHolder({"a": [tiny], "b": ArrayHolder(tiny)})) == 3


def test_shipped_sensors_have_no_denormals():
    for name in ("dense", "paper16"):
        design = load_sensor(name)
        assert (
            denormals.count(
                SensingPipeline(design), Renderer(design), _brush(design.camera.blur_px)
            )
            == 0
        )
