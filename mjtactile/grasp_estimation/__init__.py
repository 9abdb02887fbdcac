"""Properties of the grasped object from touch, for any controller.

`touch_statics` evaluates one moment and `slip_test` tests for slip. `friction_filter`,
`load_estimator` and `grip_stiffness` track friction, load and stiffness from image to image.
"""

from mjtactile.grasp_estimation.friction_filter import FrictionFilter
from mjtactile.grasp_estimation.grip_stiffness import GripStiffnessEstimator
from mjtactile.grasp_estimation.load_estimator import FrameLoadEstimator, LoadEstimator
from mjtactile.grasp_estimation.slip_signs import slip_sign
from mjtactile.grasp_estimation.slip_test import SlipTestResult, evaluate_slip_test
from mjtactile.grasp_estimation.touch_statics import (
    GAIN_SD,
    GRAVITY,
    Friction,
    Weight,
    estimate_friction,
    estimate_weight,
    external_shear,
    load_direction,
    load_vector,
    min_grip_force,
    pull_force,
    shear,
    stands,
    support_force,
)

__all__ = [
    "GAIN_SD",
    "GRAVITY",
    "FrameLoadEstimator",
    "Friction",
    "FrictionFilter",
    "GripStiffnessEstimator",
    "LoadEstimator",
    "SlipTestResult",
    "Weight",
    "estimate_friction",
    "estimate_weight",
    "evaluate_slip_test",
    "external_shear",
    "load_direction",
    "load_vector",
    "min_grip_force",
    "pull_force",
    "shear",
    "slip_sign",
    "stands",
    "support_force",
]
