"""Tests of slip of a body dragged past two sensors: the true speed is that of the sensors, and slip
is detected in time."""

import numpy as np
import pytest

from benchmarks.scenes.slip_cases import sample_slip_case
from benchmarks.scenes.slip_world import SlipWorld
from benchmarks.slip.evaluate_case import references, watch
from benchmarks.slip.score import Frame, outcome
from mjtactile.core.design import load_sensor
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sim import ground_truth

CASE = sample_slip_case(1000)  # an upright cylinder past which both fingers move


def test_ground_truth_slip_speed_is_the_drag_speed():
    world = SlipWorld(load_sensor("dense"), CASE)
    world.inflate(1000.0)
    for _ in world.grip():
        pass
    assert ground_truth.sliding(world, 0)[0] < 0.9
    used = []
    speeds = []
    for _ in world.load(0.8 * CASE.fraction / CASE.rise):  # of the fingers' way
        fraction, speed = ground_truth.sliding(world, 0)
        used.append(fraction)
        speeds.append(speed)
    late = slice(-20, None)
    # within friction's accuracy of 3 %, and vertices that stick
    assert np.mean(used[late]) == pytest.approx(1.0, abs=0.05)
    # the membrane still stretches slightly
    assert np.mean(speeds[late]) == pytest.approx(1e-3 * CASE.rise, rel=0.15)


def test_a_slip_is_reported_in_time_from_pixels():
    design = load_sensor("dense")
    sensing_pipeline = SensingPipeline(design)
    watched = watch(design, sensing_pipeline, references(design, sensing_pipeline, CASE), CASE)
    for samples in watched.fingers:
        frames = [
            Frame(k.time, k.touch.slip.state, k.used, k.slid, k.onset)
            for k in samples
            if k.touch.slip is not None
        ]
        assert outcome(frames).name == "in time"
