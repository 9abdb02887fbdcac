"""Properties of the grasped object from touch, for any controller.

`touch_statics` evaluates one moment and `slip_test` tests for slip. Other modules track friction,
load and stiffness from image to image. These are `friction_estimator`, `frame_load`,
`load_estimator`, `grip_stiffness` and `friction_probe`.
"""

from mjtactile.grasp_estimation.frame_load import FrameLoadEstimator
from mjtactile.grasp_estimation.friction_estimator import FrictionEstimator
from mjtactile.grasp_estimation.friction_probe import FrictionProbe
from mjtactile.grasp_estimation.grip_stiffness import GripStiffnessEstimator
from mjtactile.grasp_estimation.load_estimator import LoadEstimator
from mjtactile.grasp_estimation.slip_test import SlipTestResult, evaluate_slip_test
from mjtactile.grasp_estimation.touch_statics import (
    GAIN_SD,
    GRAVITY,
    Friction,
    Weight,
    estimate_friction,
    estimate_weight,
    load_direction,
    load_vector,
    min_grip_force,
    pull_force,
    shear,
    support_force,
)

__all__ = [
    "GAIN_SD",
    "GRAVITY",
    "FrameLoadEstimator",
    "Friction",
    "FrictionEstimator",
    "FrictionProbe",
    "GripStiffnessEstimator",
    "LoadEstimator",
    "SlipTestResult",
    "Weight",
    "estimate_friction",
    "estimate_weight",
    "evaluate_slip_test",
    "load_direction",
    "load_vector",
    "min_grip_force",
    "pull_force",
    "shear",
    "support_force",
]
