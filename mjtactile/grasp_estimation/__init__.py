"""What a hand can know of the thing that it holds, from what its fingers feel; for any controller
(`felt`: of one moment; `follow`: the test for slip; `belief`,
`frames`, `load`, `spring` and `trial`: friction, load and stiffness, from image to image)."""

from mjtactile.hold.belief import Belief
from mjtactile.hold.felt import (
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
from mjtactile.hold.follow import Following, follows
from mjtactile.hold.frames import Frames
from mjtactile.hold.load import Load
from mjtactile.hold.spring import Spring
from mjtactile.hold.trial import Trial

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
