"""Random graspable objects: `random:SEED` instead of an object's name or file.

They are 16 to 60 mm wide between the fingers, 15 to 70 mm high, 5 to 200 g, and stand upright. A
stand raises an object that is too low for the sensors' frames. Each withstands at least three times
the force that carries it at a friction of 0.9.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core.types import Array

PREFIX = "random:"
_MASS = (5e-3, 0.2)  # kg
_CARRIES = 3 * 9.81 / (2 * 0.9)  # required strength, N per kg on each finger
# range of break forces, N: a strawberry, a jar
_FRAGILE = 1.2
_STURDY = 10.0
# minimum height of the grasp center over the table, m: the sensors' frames are 18 mm below it
_CLEAR = 0.026
# distance of a stand's edge inside the object's edge, m: membranes compress the object by 3 mm
_ASIDE = 4.5e-3
_FOOT = 0.45  # radius of an egg's flat foot, over its own
_CORNERS = 48  # vertices around a cone's mesh
_ARC = 5  # vertices of a mesh along a quarter of a rounded edge
_SEGMENTS = 8  # number of segments of a fruit's flesh
_FRICTION = 'friction="0.3 0.005 0.0001"'


@dataclass(frozen=True)
class RandomObject:
    """Parameters of a random object.

    Half sizes are `a` (x, between the fingers), `b` (y), `c` (z) m. `mass` is kg, `break_force` N
    on each finger. `detail` is the edge radius m of a box, the slope (radius lost per height) of a
    cone, neck radius and height m of a bottle, the stiffness N/m of a fruit.
    """

    shape: str
    a: float
    b: float
    c: float
    mass: float
    break_force: float
    detail: tuple[float, ...] = ()

    @property
    def values(self) -> dict[str, Any]:
        """Sampled values, for results."""
        return {
            "random.shape": self.shape,
            "random.width_mm": round(2e3 * self.a, 3),
            "random.height_mm": round(2e3 * self.c, 3),
            "random.mass_g": round(1e3 * self.mass, 3),
            "random.break_force_N": round(self.break_force, 4),
        }


Rng = np.random.Generator


def seed_of(name: str) -> int | None:
    """Return the seed in "random:7"; None for any other name."""
    digits = name.removeprefix(PREFIX)
    if name.startswith(PREFIX) and digits.isdecimal():
        return int(digits)
    return None


def object_text(name: str) -> str | None:
    """Return the MJCF of "random:7"; None for any other name."""
    seed = seed_of(name)
    return None if seed is None else to_mjcf(random_object(seed), "random")


def random_object(seed: int) -> RandomObject:
    """Return the object of `seed`."""
    rng = np.random.default_rng([seed, zlib.crc32(b"random object")])
    shape = str(rng.choice(list(_SHAPES)))
    (a, b, c), detail, volume, density = _SHAPES[shape][0](rng)
    mass = float(np.clip(volume * density, *_MASS))
    minimum = max(_FRAGILE, _CARRIES * mass)
    return RandomObject(shape, a, b, c, mass, _log(rng, minimum, _STURDY), detail)


Sample = tuple[tuple[float, float, float], tuple[float, ...], float, float]
"""Half sizes, details, volume m^3, density kg/m^3."""


def _egg(rng: Rng) -> Sample:
    a = rng.uniform(0.010, 0.025)
    c = a * rng.uniform(1.1, 1.4)
    return (a, a, c), (), 4 / 3 * math.pi * a * a * c, rng.uniform(400, 1100)


def _box(rng: Rng) -> Sample:
    a = rng.uniform(0.009, 0.028)
    b = rng.uniform(0.009, 0.025)
    c = rng.uniform(0.0075, 0.035)
    return (
        (a, b, c),
        (rng.uniform(0.0025, max(0.35 * min(a, b, c), 0.0027)),),
        8 * a * b * c,
        rng.uniform(200, 1200),
    )


def _cylinder(rng: Rng) -> Sample:
    c = rng.uniform(0.0075, 0.035)
    a = rng.uniform(0.010 if c < _CLEAR else 0.008, 0.030)
    return (a, a, c), (), 2 * math.pi * a * a * c, rng.uniform(300, 1500)


def _cone(rng: Rng) -> Sample:
    a = rng.uniform(0.011, 0.028)
    c = rng.uniform(0.010, 0.035)
    slope = rng.uniform(-0.1, 0.1)
    return (a, a, c), (slope,), 2 * math.pi * a * a * c, rng.uniform(150, 900)


def _bottle(rng: Rng) -> Sample:
    a = rng.uniform(0.010, 0.025)
    c = rng.uniform(0.016, 0.026)
    neck = a * rng.uniform(0.3, 0.6), rng.uniform(0.006, 0.016)
    return (a, a, c), neck, 2 * math.pi * a * a * c, rng.uniform(200, 1100)


def _fruit(rng: Rng) -> Sample:
    a = rng.uniform(0.011, 0.020)
    c = a * rng.uniform(0.9, 1.25)
    return (a, a, c), (_log(rng, 300, 2000),), 4 / 3 * math.pi * a * a * c, rng.uniform(800, 1000)


def _log(rng: Rng, low: float, high: float) -> float:
    return float(low * (high / low) ** rng.random())


def to_mjcf(t: RandomObject, name: str) -> str:
    """Return the object's file, in the format of docs/reference/object_files.md."""
    stand = max(_CLEAR - t.c, 0.0)
    radius = max(min(t.a, t.b) - _ASIDE, 4e-3)
    if stand:
        under = (
            '    <body name="stand">\n      <geom name="stand" type="cylinder" pos="0 0 '
            f'{stand / 2:.6g}" '
            f'size="{radius:.6g} {stand / 2:.6g}" {_FRICTION} rgba="0.6 0.6 0.65 1"/>\n    '
            "</body>\n"
        )
    else:
        under = ""
    turn = '    <numeric name="rotation_deg" data="3"/>\n' if t.shape == "box" else ""
    asset, geoms = _SHAPES[t.shape][1](t)
    body = "\n".join(f"      {line}" for line in geoms)
    return f"""<!-- A random {t.shape}: {2e3 * t.a:.3g} mm between the fingers,
     {2e3 * t.c:.3g} mm high, {1e3 * t.mass:.3g} g.
     Units: m, kg, N. Made by mjtactile.sim.scenes.random_objects;
     docs/reference/object_files.md says how they are drawn. -->
<mujoco model="{name}">
  <compiler angle="degree"/>
  <custom>
    <numeric name="break_force_N" data="{t.break_force:.6g}"/>
{turn}    <text name="material" data="{"soft" if t.shape == "fruit" else "solid"}"/>
  </custom>
{asset}  <worldbody>
{under}    <body name="object" pos="0 0 {stand + t.c:.6g}">
      <freejoint/>
{body}
    </body>
  </worldbody>
</mujoco>
"""


Built = tuple[str, list[str]]
"""Assets, and the lines of the MuJoCo body."""


def _geom(
    name: str,
    kind: str,
    size: tuple[float, ...],
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0),
    more: str = "",
    colour: str = "0.7 0.75 0.8 1",
) -> str:
    return (
        f'<geom name="{name}" type="{kind}" size="{_row(size)}" pos="{_row(pos)}" {_FRICTION} '
        f'conaffinity="0" rgba="{colour}"{more}/>'
    )


def _row(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.6g}" for value in values)


def _inertial(t: RandomObject, fraction: float) -> str:
    """Return the inertial element of a solid, whose moments are `fraction` m (p^2 + q^2)."""
    moments = (
        fraction * (t.b**2 + t.c**2) * t.mass,
        fraction * (t.a**2 + t.c**2) * t.mass,
        fraction * (t.a**2 + t.b**2) * t.mass,
    )
    return f'<inertial pos="0 0 0" mass="{t.mass:.6g}" diaginertia="{_row(moments)}"/>'


def _foot(t: RandomObject) -> str:
    """Return the foot of a round object; it touches table and stand, but no membrane."""
    size = (_FOOT * t.a, 0.05 * t.c)
    low = -0.95 * t.c - 2e-4
    return _geom("foot", "cylinder", size, (0.0, 0.0, low)).replace(
        'conaffinity="0"', 'contype="0" conaffinity="1"'
    )


def _build_egg(t: RandomObject) -> Built:
    return "", [
        _inertial(t, 0.2),
        _geom("shell", "ellipsoid", (t.a, t.b, t.c), colour="0.93 0.85 0.75 1"),
        _foot(t),
    ]


def _build_box(t: RandomObject) -> Built:
    """Build the convex hull of a ball in each corner as one geom, to push the membrane once."""
    r = t.detail[0]
    lift, turn = np.meshgrid(
        np.linspace(0, np.pi / 2, _ARC), np.linspace(0, np.pi / 2, _ARC), indexing="ij"
    )
    octant = np.stack(
        [np.cos(lift) * np.cos(turn), np.cos(lift) * np.sin(turn), np.sin(lift)], axis=-1
    ).reshape(-1, 3)
    octant = np.unique(octant.round(9), axis=0)
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = signs[:, None] * (np.array([t.a - r, t.b - r, t.c - r]) + r * octant)
    return _mesh("box", corners.reshape(-1, 3), "0.7 0.75 0.8 1", _inertial(t, 1 / 3))


def _mesh(name: str, vertices: Array, colour: str, inertial: str) -> Built:
    """Build the convex hull of `vertices` (N, 3), m."""
    text = "  ".join(_row(tuple(row)) for row in vertices)
    return (
        f'  <asset>\n    <mesh name="{name}" vertex="{text}"/>\n  </asset>\n',
        [
            inertial,
            f'<geom name="body" type="mesh" mesh="{name}" {_FRICTION} conaffinity="0" '
            f'rgba="{colour}"/>',
        ],
    )


def _build_cylinder(t: RandomObject) -> Built:
    return "", [_inertial(t, 0.27), _geom("body", "cylinder", (t.a, t.c))]


def _build_cone(t: RandomObject) -> Built:
    angle = np.arange(_CORNERS) * (2 * np.pi / _CORNERS)
    rings = [
        np.column_stack(
            [
                (t.a - t.detail[0] * z) * np.cos(angle),
                (t.a - t.detail[0] * z) * np.sin(angle),
                np.full(_CORNERS, z),
            ]
        )
        for z in (-t.c, t.c)
    ]
    return _mesh("cone", np.concatenate(rings), "0.9 0.9 0.85 1", _inertial(t, 0.27))


def _build_bottle(t: RandomObject) -> Built:
    radius, height = t.detail
    return "", [
        _inertial(t, 0.27),
        _geom("body", "cylinder", (t.a, t.c), colour="0.7 0.85 0.9 0.6"),
        _geom("shoulder", "ellipsoid", (0.98 * t.a, 0.98 * t.a, 0.5 * t.a), (0.0, 0.0, t.c)),
        _geom(
            "neck",
            "cylinder",
            (radius, height / 2 + 0.25 * t.a),
            (0.0, 0.0, t.c + 0.25 * t.a + height / 2),
        ),
    ]


def _build_fruit(t: RandomObject) -> Built:
    """Build flesh segments around a core, each on a radial spring, as in the shipped strawberry."""
    stiffness = t.detail[0]
    shift = 0.4 * t.a
    size = (t.a - shift, 0.72 * t.a, t.c)
    part = 0.5 * t.mass / _SEGMENTS
    damping = 2 * 0.7 * math.sqrt(stiffness * part)
    lines = [
        f'{_foot(t)[:-2]} mass="{0.25 * t.mass:.6g}"/>',
        _geom(
            "core",
            "ellipsoid",
            (0.6 * t.a, 0.6 * t.a, 0.9 * t.c),
            more=f' mass="{0.25 * t.mass:.6g}" contype="0"',
        ),
    ]
    for k in range(_SEGMENTS):
        angle = 2 * math.pi * k / _SEGMENTS
        x, y = shift * math.cos(angle), shift * math.sin(angle)
        lines += [
            f'<body name="flesh{k}" pos="{x:.6g} {y:.6g} 0" euler="0 0 {math.degrees(angle):g}">',
            f'  <joint name="flesh{k}" type="slide" axis="1 0 0" '
            f'stiffness="{stiffness:.6g}" damping="{damping:.4g}"/>',
            "  "
            + _geom(
                f"flesh{k}", "ellipsoid", size, more=f' mass="{part:.6g}"', colour="0.85 0.3 0.25 1"
            ),
            "</body>",
        ]
    return "", lines


_SHAPES: dict[str, tuple[Callable[[Rng], Sample], Callable[[RandomObject], Built]]] = {
    "egg": (_egg, _build_egg),
    "box": (_box, _build_box),
    "cylinder": (_cylinder, _build_cylinder),
    "cone": (_cone, _build_cone),
    "bottle": (_bottle, _build_bottle),
    "fruit": (_fruit, _build_fruit),
}
