"""What a hand can know of the thing that it holds, from what its fingers feel; for any controller
(`felt`: of one moment; `follow`: the test for slip; `belief`,
`frames`, `load`, `spring` and `trial`: friction, load and stiffness, from image to image)."""

from mjtactile.grasp_estimation.frame_load import Frames
from mjtactile.grasp_estimation.friction_estimator import Belief
from mjtactile.grasp_estimation.friction_probe import Trial
from mjtactile.grasp_estimation.grip_stiffness import Spring
from mjtactile.grasp_estimation.load_estimator import Load
from mjtactile.grasp_estimation.slip_test import Following, follows
from mjtactile.grasp_estimation.touch_statics import (
    GAIN_SD,
    GRAVITY,
    Friction,
    Weight,
    downward,
    friction,
    least_grip,
    load_vector,
    pull,
    shear,
    support,
    weigh,
)

__all__ = [
    "GAIN_SD",
    "GRAVITY",
    "Belief",
    "Following",
    "Frames",
    "Friction",
    "Load",
    "Spring",
    "Trial",
    "Weight",
    "downward",
    "follows",
    "friction",
    "least_grip",
    "load_vector",
    "pull",
    "shear",
    "support",
    "weigh",
]
