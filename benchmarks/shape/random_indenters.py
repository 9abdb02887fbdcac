"""Random indenters of `bench shape`: their MJCF file and their true shape. SI units; the indenter
moves along -z."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mjtactile.core.types import Array
from mjtactile.sensing.contact_shape.shape_models import SHARP

_MESH = '<geom type="mesh" mesh="hull"/>'
_SIDES = 40  # sides of the polygon that approximates a circle


@dataclass(frozen=True)
class Case:
    """An indenter.

    The true shape model `family`, its `name`, geoms as MJCF text, and its `radius`, m, if it has
    one. `curvatures`, 1/m, larger first, of smooth shapes. `direction`, rad from x, of an edge, a
    cylinder axis, or the smaller curvature. `at` (2,), m, is the position of the load.
    """

    family: str
    name: str
    geoms: str
    at: tuple[float, float]
    assets: str = ""
    radius: float = np.nan
    curvatures: tuple[float, float] = (np.nan, np.nan)
    direction: float = np.nan
    extra: dict[str, float] = field(default_factory=dict)

    def write(self, folder: Path) -> Path:
        """Write the MJCF file to `folder`, and return its path."""
        path = folder / "body.xml"
        path.write_text(
            f"<mujoco><asset>{self.assets}</asset><worldbody>{self.geoms}</worldbody></mujoco>",
            encoding="utf-8",
        )
        return path


def sample_case(seed: int) -> Case:
    """Sample the indenter of a seed; shape models take turns."""
    rng = np.random.default_rng([seed, 77])
    name = list(_SAMPLED)[seed % len(_SAMPLED)]
    at = (float(rng.uniform(-7e-3, 7e-3)), float(rng.uniform(-5e-3, 5e-3)))
    return _SAMPLED[name](rng, name, at)


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _ball(rng: np.random.Generator, name: str, at: tuple[float, float]) -> Case:
    radius = _log_uniform(rng, 3e-3, 40e-3)
    geoms = f'<geom type="sphere" size="{radius}"/>'
    family = "smooth" if 1 / radius < SHARP else "point"
    return Case(family, name, geoms, at, radius=radius, curvatures=(1 / radius, 1 / radius))


def _ellipsoid(rng: np.random.Generator, name: str, at: tuple[float, float]) -> Case:
    c = float(rng.uniform(8e-3, 20e-3))
    # half-axes from curvatures below those of edges and tips
    a, b = np.sqrt(c / rng.uniform(20.0, SHARP, 2))
    angle = float(rng.uniform(0, np.pi))
    rotation = f'euler="0 0 {np.degrees(angle)}"'
    geoms = f'<geom type="ellipsoid" size="{a} {b} {c}" {rotation}/>'
    bent = (c / a**2, c / b**2)
    direction = angle if bent[0] < bent[1] else angle + np.pi / 2
    curvatures = (max(bent), min(bent))
    return Case("smooth", name, geoms, at, curvatures=curvatures, direction=direction % np.pi)


def _lying(rng: np.random.Generator, name: str, at: tuple[float, float]) -> Case:
    radius = _log_uniform(rng, 3e-3, 20e-3)
    angle = float(rng.uniform(0, np.pi))
    corner = 0.03 * np.array([np.cos(angle), np.sin(angle)])
    ends = f"{-corner[0]} {-corner[1]} 0 {corner[0]} {corner[1]} 0"
    geoms = f'<geom type="cylinder" size="{radius}" fromto="{ends}"/>'
    family = "smooth" if 1 / radius < SHARP else "edge"
    return Case(
        family, name, geoms, at, radius=radius, curvatures=(1 / radius, 0.0), direction=angle
    )


def _standing(rng: np.random.Generator, name: str, at: tuple[float, float]) -> Case:
    radius = float(rng.uniform(2.5e-3, 7e-3))
    tilt, about = float(rng.uniform(0, 4)), float(rng.uniform(0, 2 * np.pi))
    geoms = f'<geom type="cylinder" size="{radius} 0.015" {_tilted(tilt, about)}/>'
    return Case("flat", name, geoms, at, radius=radius, extra={"tilt_deg": tilt})


def _round_rim(rng: np.random.Generator, name: str, at: tuple[float, float]) -> Case:
    radius, rim = float(rng.uniform(3e-3, 7e-3)), float(rng.uniform(0.3e-3, 1e-3))
    angle = np.linspace(0, 2 * np.pi, _SIDES, endpoint=False)
    profile = [
        (radius - rim + rim * np.sin(t), -rim * np.cos(t)) for t in np.linspace(0, np.pi / 2, 7)
    ]
    profile.append((radius, 0.02))
    points = [(r * np.cos(t), r * np.sin(t), z) for r, z in profile for t in angle]
    return Case(
        "flat",
        name,
        _MESH,
        at,
        _mesh(np.array(points)),
        radius=radius,
        extra={"wall_mm": 1e3 * rim},
    )


def _block(rng: np.random.Generator, name: str, at: tuple[float, float]) -> Case:
    half = rng.uniform(2.5e-3, 6e-3, 2)
    angle = float(rng.uniform(0, np.pi))
    tilt = rng.uniform(-3, 3, 2)
    rotation = f'euler="{tilt[0]} {tilt[1]} {np.degrees(angle)}"'
    geoms = f'<geom type="box" size="{half[0]} {half[1]} 0.01" {rotation}/>'
    return Case("flat", name, geoms, at, extra={"tilt_deg": float(np.hypot(*tilt))})


def _wedge(rng: np.random.Generator, name: str, at: tuple[float, float]) -> Case:
    opening = np.radians(rng.uniform(60, 150))
    angle = float(rng.uniform(0, np.pi))
    lean = np.radians(rng.uniform(-3, 3))
    wide = 0.012 * np.tan(opening / 2)
    corners = [(x, 0.0, 0.0) for x in (-0.03, 0.03)]
    corners += [(x, y, 0.012) for x in (-0.03, 0.03) for y in (-wide, wide)]
    c, s = np.cos(lean), np.sin(lean)
    leaning = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    c, s = np.cos(angle), np.sin(angle)
    turned = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    assets = _mesh(np.array(corners) @ leaning.T @ turned.T)
    extra = {"opening_deg": float(np.degrees(opening)), "lean_deg": float(np.degrees(lean))}
    return Case("edge", name, _MESH, at, assets, direction=angle, extra=extra)


def _corner(rng: np.random.Generator, name: str, at: tuple[float, float]) -> Case:
    half_angle = np.radians(rng.uniform(40, 65))
    sides = int(rng.integers(3, 6))
    angle = float(rng.uniform(0, 2 * np.pi)) + np.arange(sides) * 2 * np.pi / sides
    rho = 0.01 * np.tan(half_angle)
    ring = np.column_stack([rho * np.cos(angle), rho * np.sin(angle), np.full(sides, 0.01)])
    return Case(
        "point",
        name,
        _MESH,
        at,
        _mesh(np.vstack([[0, 0, 0], ring])),
        extra={"half_angle_deg": float(np.degrees(half_angle)), "sides": sides},
    )


def _two_balls(rng: np.random.Generator, name: str, at: tuple[float, float]) -> Case:
    radius = rng.uniform(3e-3, 6e-3, 2)
    angle = float(rng.uniform(0, np.pi))
    half = rng.uniform(5e-3, 8e-3)
    corner = half * np.array([np.cos(angle), 0.7 * np.sin(angle)])
    low = -radius - rng.uniform(-1.5e-4, 1.5e-4) * np.array([1, -1])
    geoms = "".join(
        f'<geom type="sphere" size="{r}" pos="{s * corner[0]} {s * corner[1]} {-z}"/>'
        for s, r, z in zip((-1, 1), radius, low, strict=True)
    )
    return Case("multiple", name, geoms, (at[0] / 4, at[1] / 4), direction=angle)


def _tilted(degrees: float, about: float) -> str:
    return f'axisangle="{np.cos(about)} {np.sin(about)} 0 {degrees}"'


def _mesh(points: Array) -> str:
    """Return the asset of the convex hull of `points` (n, 3), m, as MJCF text."""
    text = " ".join(f"{value:.9g}" for value in points.ravel())
    return f'<mesh name="hull" vertex="{text}"/>'


_SAMPLED: dict[str, Callable[[np.random.Generator, str, tuple[float, float]], Case]] = {
    "ball": _ball,
    "wedge": _wedge,
    "standing cylinder": _standing,
    "ellipsoid": _ellipsoid,
    "corner": _corner,
    "lying cylinder": _lying,
    "block": _block,
    "round rim": _round_rim,
    "two balls": _two_balls,
}
