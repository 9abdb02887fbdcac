"""Random cases of slip and of holding: object, grip force and load of each seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

OBJECTS = ("ball", "box", "cylinder", "lying cylinder", "soft block", "soft ball")
FRICTION = (0.3, 1.2)
SPEED = (2e-3, 40e-3)  # final speed of a slipping object without a moving finger, m/s
_SHEAR_MAX = 1.0  # maximum shear of the membrane, N: a larger one wrinkles it


@dataclass(frozen=True)
class LoadProfile:
    """Type of load on a held object.

    `load` names the quantity that grows: a "pull", a "torque", a "shake" of the gripper, a "drag"
    past an anchored object, the "grip" that opens under a pull, "one" moving finger, "roll" (both
    fingers, in opposite directions), "squeeze" or "tap" (none). `fraction`: range of its peak,
    relative to the friction limit (for moved parts the displacement, mm). `rise` is the time to the
    peak, s (for moved parts the speed, mm/s). `stays` is true if the load stays at its peak, else
    it keeps growing.
    """

    load: str
    fraction: tuple[float, float]
    rise: tuple[float, float]
    stays: bool = True


SLIPS = {
    "pull": LoadProfile("pull", (1.3, 2.0), (0.4, 1.8), stays=False),
    "too heavy": LoadProfile("pull", (1.05, 1.4), (0.2, 1.0)),
    "sudden": LoadProfile("pull", (1.2, 2.0), (0.02, 0.06)),
    "grip opened": LoadProfile("grip", (0.4, 0.8), (0.5, 3.0)),
    "drag": LoadProfile("drag", (3.0, 6.0), (1.0, 10.0)),
    "shaken loose": LoadProfile("shake", (1.2, 2.0), (0.2, 0.5)),
    "torsion": LoadProfile("torque", (1.2, 2.0), (0.3, 1.5), stays=False),
    "one of two": LoadProfile("one", (2.5, 4.0), (1.0, 10.0)),
}
HOLDS = {
    "pulled": LoadProfile("pull", (0.2, 0.8), (0.2, 1.5)),
    "lifted": LoadProfile("pull", (0.3, 0.8), (0.1, 0.5)),
    "jerked": LoadProfile("pull", (0.2, 0.6), (0.02, 0.06)),
    "grip eased": LoadProfile("grip", (0.2, 0.4), (0.5, 2.0)),
    "shaken": LoadProfile("shake", (0.2, 0.7), (0.2, 0.5)),
    "twisted": LoadProfile("torque", (0.2, 0.5), (0.3, 1.5)),
    "sheared": LoadProfile("one", (0.1, 0.4), (1.0, 5.0)),
    "rolled": LoadProfile("roll", (0.5, 1.5), (1.0, 5.0)),
    "squeezed": LoadProfile("squeeze", (0.1, 0.6), (0.1, 0.5)),
    "tapped": LoadProfile("tap", (0.3, 2.0), (0.05, 0.2)),
}


@dataclass(frozen=True)
class SlipCase:
    """One case.

    Object `size`, m (radius or half an edge), and `mass`, kg. `friction` of the left and the right
    membrane against it, and the `grip` force, N, on each. `offset` (2,), m, of the object from the
    membrane centers. `angle`, rad, of the pull in their plane. `speed`, m/s, that a slipping object
    reaches.
    """

    seed: int
    name: str
    slips: bool
    profile: LoadProfile
    body: str
    size: float
    mass: float
    friction: tuple[float, float]
    grip: float
    offset: tuple[float, float]
    angle: float
    fraction: float
    rise: float
    speed: float
    frequency: float


def sample_slip_case(seed: int) -> SlipCase:
    """Sample the case of a seed.

    Slips and holds alternate, and the kinds of load take turns. All else is random.
    """
    rng = np.random.default_rng([seed, 12])
    motions = SLIPS if seed % 2 == 0 else HOLDS
    name = list(motions)[seed // 2 % len(motions)]
    motion = motions[name]
    body = OBJECTS[rng.integers(len(OBJECTS))]
    mu = float(rng.uniform(*FRICTION))
    other = mu
    if motion.load == "one":  # the left one slips or both hold
        other = min(FRICTION[1], mu * rng.uniform(1.5, 2.5))
        mu = other / rng.uniform(1.5, 2.5)
    if motion.load == "roll":
        body = ("ball", "lying cylinder")[rng.integers(2)]
    friction = (max(mu, FRICTION[0]), max(other, FRICTION[0]))
    size = rng.uniform(7e-3, 16e-3)
    mass = rng.uniform(0.08, 0.2) if motion.load == "shake" else rng.uniform(0.005, 0.06)
    return SlipCase(
        seed,
        name,
        motion is SLIPS.get(name),
        motion,
        body,
        float(size),
        float(mass),
        friction,
        grip=float(min(rng.uniform(0.25, 1.5), _SHEAR_MAX / max(friction))),
        offset=(float(rng.uniform(-4e-3, 4e-3)), float(rng.uniform(-3e-3, 3e-3))),
        angle=float(rng.uniform(0, 2 * np.pi)),
        fraction=float(rng.uniform(*motion.fraction)),
        rise=float(rng.uniform(*motion.rise)),
        speed=float(np.exp(rng.uniform(*np.log(SPEED)))),
        frequency=float(rng.uniform(4, 8)),
    )
