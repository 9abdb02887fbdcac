"""Objects without a shape model on a fine quasi-static membrane, with camera noise on the markers.

Their true pose and curvatures are compared with the reported intervals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile import QuasistaticMembrane, SensingPipeline, load_sensor
from mjtactile.core.types import Array, ContactShape, Markers
from mjtactile.quasistatic import MembraneSolution, Obstacle, obstacle
from mjtactile.quasistatic.interpolation import interpolation_matrix

FIRST_SEED = 6000  # not used for tuning
OBJECTS, OBJECTS_QUICK = 5, 1  # objects of each kind
_GRID = (61, 46)
_NOISE = np.array([3.4e-6, 3.4e-6, 19e-6])  # marker noise of one image of `dense`, m
_DEPTHS = np.array([0.4, 0.8, 1.2, 1.7, 2.3, 3.0]) * 1e-3
_FORCES = (0.1, 1.5)  # range of evaluated forces, N
_TALL = 0.015  # half height of standing objects, m
_STEEP = 2.0  # slope of a height field beyond an object: the membrane does not reach it

Build = Callable[[QuasistaticMembrane, Array], list[Obstacle]]


@dataclass(frozen=True)
class Foreign:
    """An object. `build` makes its obstacles with the lowest point at a position (3,), m. True
    values are the `curvatures`, 1/m, and the `tilt`, rad; NaN: not defined. `tip` is True if its
    lowest point is one."""

    build: Build
    curvatures: tuple[float, float] = (np.nan, np.nan)
    tilt: float = np.nan
    tip: bool = False


def rows(count: int = OBJECTS) -> list[dict[str, Any]]:
    """Press `count` objects of each kind.

    Returns:
        One row per image from 0.1 N on.
    """
    bench = _Bench()
    found = []
    for name, sample in KINDS.items():
        for number in range(count):
            rng = np.random.default_rng([FIRST_SEED + number, len(name)])
            found += [{"family": name, **row} for row in bench.press(sample(rng), rng)]
    return found


class _Bench:
    """Membrane and sensing pipeline of `dense`."""

    def __init__(self) -> None:
        design = load_sensor("dense")
        self._membrane = QuasistaticMembrane(design, _GRID)
        self._places = design.markers.p_SM
        self._by_node = interpolation_matrix(self._membrane, self._places[:, :2])
        self._pipeline = SensingPipeline(design)
        rest = _seen(self._markers(self._membrane.rest))
        self._state = self._pipeline.load_rest_reference(
            self._pipeline.initial_state(), rest, self._membrane.gauge_pressure
        )
        self._finder = self._pipeline.make_shape_estimator(self._state)

    def press(self, shape: Foreign, rng: np.random.Generator) -> list[dict[str, Any]]:
        """Lower the object in steps; return a row for each image."""
        at = rng.uniform(-1, 1, 2) * (6e-3, 4e-3)
        membrane, pipeline = self._membrane, self._pipeline
        nodes = np.stack(np.meshgrid(membrane.x, membrane.y, indexing="ij"), axis=-1)
        below = membrane.obstacle_heights(
            shape.build(membrane, np.array([*at, 0.0])), nodes.reshape(-1, 2)
        )
        there = np.isfinite(below)
        touching = (membrane.rest.heights.ravel()[there] - below[there]).max()
        before = self._state
        batch, found = None, []
        for number, depth in enumerate(_DEPTHS):
            place = np.array([*at, touching - depth])
            batch = membrane.solve_batch([shape.build(membrane, place)], batch)
            force = float(batch.force_normal[0])
            if not force < _FORCES[1]:
                break
            places = self._markers(batch[0])
            markers = _seen(places + _NOISE * rng.standard_normal(places.shape))
            fitted = pipeline.fitter.fit(markers)
            touch, after = pipeline.estimate_touch(before, markers, fitted, (number + 1) / 30)
            touch, before = pipeline.track_contact_shape(before, after, touch, self._finder)
            if touch.shape is not None and force > _FORCES[0]:
                row = {"force_N": force, "area_true_mm2": 1e6 * batch[0].area}
                found.append(row | _compared(shape, place, touch.shape))
        return found

    def _markers(self, state: MembraneSolution) -> Array:
        moved = self._by_node @ state.x.reshape(3, -1).T
        flat = np.column_stack([self._places[:, :2], np.zeros(len(self._places))])
        return flat + moved


def _compared(shape: Foreign, place: Array, estimated: ContactShape) -> dict[str, Any]:
    """Return the errors over their standard deviations."""
    row: dict[str, Any] = {"kind": estimated.kind, "area_mm2": 1e6 * estimated.area}
    row["area_interval_mm2"] = [1e6 * end for end in estimated.area_interval]
    if estimated.kind == "unknown":
        return row
    sd = np.sqrt(np.diag(estimated.pose_cov))
    if shape.tip:
        off = estimated.p_SO[:2] - place[:2]
        row["tip"] = float(np.hypot(*off) / np.hypot(*sd[:2]))
    if np.isfinite(shape.tilt) and estimated.kind == "flat":
        tilt = float(np.arccos(np.clip(estimated.R_SO[2, 2], -1, 1)))
        row["tilt"] = abs(tilt - shape.tilt) / float(np.hypot(*sd[3:5]))
    if estimated.kind == "smooth":
        given = zip(estimated.curvatures, shape.curvatures, estimated.curvatures_sd, strict=True)
        row["curvatures"] = [
            abs(found - true) / known
            for found, true, known in given
            if known > 0 and np.isfinite(true)
        ]
    return row


def _seen(places: Array) -> Markers:
    count = len(places)
    cov = np.tile(np.diag(_NOISE**2), (count, 1, 1))
    return Markers(np.arange(count), places, np.tile([0.0, 0.0, 1.0], (count, 1)), cov)


def table(listed: list[dict[str, Any]]) -> list[str]:
    """Return the lines of a Markdown table, one row per kind.

    Args:
        listed: Rows of `rows`.
    """
    lines = [
        "| foreign shape, from 0.1 N | images | estimated | within 2 sd "
        "(lateral: of the lowest point) | area error, median |",
        "|---|---|---|---|---|",
    ]
    for name in [*KINDS, ""]:
        own = [row for row in listed if name in ("", row["family"])]
        known = [row for row in own if row["kind"] != "unknown"]
        errors = [abs(row["area_mm2"] / row["area_true_mm2"] - 1) for row in known]
        area = f"{100 * np.median(errors):.0f} %" if errors and name in _WITH_AREA else ""
        fraction = f"{100 * len(known) / max(len(own), 1):.0f} %"
        fractions = ", ".join(_within(known, key) for key in _COMPARED if _values(known, key))
        lines.append(f"| {name or 'all'} | {len(own)} | {fraction} | {fractions} | {area} |")
    return lines


_COMPARED = {"tip": "lateral", "tilt": "tilt", "curvatures": "curvature"}
_WITH_AREA = ("ellipsoid 7 x 12 x 19", "tilted disc", "tilted block", "superquadric")


def _values(listed: list[dict[str, Any]], key: str) -> list[float]:
    return [value for row in listed if key in row for value in np.atleast_1d(row[key]).tolist()]


def _within(listed: list[dict[str, Any]], key: str) -> str:
    values = _values(listed, key)
    fraction = np.mean([value < 2 for value in values])
    return f"{_COMPARED[key]} {100 * fraction:.0f} % ({len(values)})"


# -- kinds of objects


def _turn(axis: int, angle: float) -> Array:
    """Return the rotation about one axis."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[i, i], R[j, j], R[j, i], R[i, j] = c, c, s, -s
    return R


def _field(heights: Callable[[Array, Array], Array], angle: float = 0.0) -> Build:
    """Return the builder of a height field over x and y, rotated by `angle`."""

    def build(membrane: QuasistaticMembrane, p: Array) -> list[Obstacle]:
        x, y = np.meshgrid(membrane.x - p[0], membrane.y - p[1], indexing="ij")
        u, v = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
        return [obstacle("heights", data=p[2] + heights(u, v))]

    return build


def _ellipsoid(rng: np.random.Generator) -> Foreign:
    a, b, c = [(7e-3, 12e-3, 19e-3), (7e-3, 19e-3, 12e-3), (12e-3, 19e-3, 7e-3)][rng.integers(3)]
    R = _turn(2, rng.uniform(0, np.pi))
    bent = (max(c / a**2, c / b**2), min(c / a**2, c / b**2))
    return Foreign(
        lambda _, p: [obstacle("ellipsoid", (a, b, c), p + [0, 0, c], R)], bent, tip=True
    )


def _corner(rng: np.random.Generator) -> Foreign:
    half = np.radians(rng.uniform(40, 60))
    turns = rng.uniform(0, 2 * np.pi) + np.arange(3) * 2 * np.pi / 3
    wide = 0.01 * np.tan(half)
    ring = np.column_stack([wide * np.cos(turns), wide * np.sin(turns), np.full(3, 0.01)])
    data = np.vstack([np.zeros(3), ring])
    return Foreign(lambda _, p: [obstacle("mesh", (), p, data=data)], tip=True)


def _tilted(rng: np.random.Generator, largest: float) -> tuple[float, Array]:
    tilt, about = np.radians(rng.uniform(0, largest)), rng.uniform(0, 2 * np.pi)
    return tilt, _turn(2, about) @ _turn(0, tilt) @ _turn(2, -about)


def _tilted_disc(rng: np.random.Generator) -> Foreign:
    radius = float(rng.uniform(4e-3, 6e-3))
    tilt, R = _tilted(rng, 12)
    up = _TALL * np.cos(tilt) + radius * np.sin(tilt)
    return Foreign(
        lambda _, p: [obstacle("cylinder", (radius, _TALL), p + [0, 0, up], R)], tilt=tilt
    )


def _tilted_block(rng: np.random.Generator) -> Foreign:
    halves = np.array([*rng.uniform(3e-3, 6e-3, 2), _TALL])
    tilt, R = _tilted(rng, 10)
    R = R @ _turn(2, rng.uniform(0, np.pi))
    up = float(np.abs(R[2]) @ halves)
    return Foreign(lambda _, p: [obstacle("box", halves, p + [0, 0, up], R)], tilt=tilt)


def _rounded_wedge(rng: np.random.Generator) -> Foreign:
    slope = min(1 / np.tan(np.radians(rng.uniform(60, 150)) / 2), 1.3)
    w = float(np.exp(rng.uniform(np.log(0.3e-3), np.log(2e-3))))
    return Foreign(_field(lambda u, v: slope * (np.hypot(v, w) - w) + 0 * u, rng.uniform(0, np.pi)))


def _superquadric(rng: np.random.Generator) -> Foreign:
    power = rng.uniform(2.4, 3.5)
    a, b, c = rng.uniform(5e-3, 9e-3, 3)

    def heights(u: Array, v: Array) -> Array:
        q = np.abs(u / a) ** power + np.abs(v / b) ** power
        inside = c * (1 - np.clip(1 - q, 1e-3, None) ** (1 / power))
        return inside + 1.5 * np.clip(q - 0.96, 0, None) * c / power

    return Foreign(_field(heights, rng.uniform(0, np.pi)))


def _round_profile(off: Array, radius: float) -> Array:
    """Return heights over the lowest line of a rod; `off` is the distance from it, m."""
    top = radius - np.sqrt(np.clip(radius**2 - off**2, 0.04 * radius**2, None))
    return top + _STEEP * np.clip(off - 0.98 * radius, 0, None)


def _torus(rng: np.random.Generator) -> Foreign:
    radius, thick = rng.uniform(5e-3, 8e-3), rng.uniform(1.5e-3, 3e-3)
    return Foreign(_field(lambda u, v: _round_profile(np.abs(np.hypot(u, v) - radius), thick)))


def _ball_and_block(rng: np.random.Generator) -> Foreign:
    radius, halves = float(rng.uniform(3e-3, 6e-3)), rng.uniform(2.5e-3, 4e-3, 2)
    angle = rng.uniform(0, np.pi)
    R = _turn(2, angle)
    off = 6.5e-3 * np.array([np.cos(angle), 0.8 * np.sin(angle), 0])

    def build(membrane: QuasistaticMembrane, p: Array) -> list[Obstacle]:
        p = p * [0.2, 0.2, 1]
        ball = obstacle("sphere", (radius,), p - off + [0, 0, radius])
        return [ball, obstacle("box", (*halves, _TALL), p + off + [0, 0, _TALL], R)]

    return Foreign(build)


def _screw(rng: np.random.Generator) -> Foreign:
    radius, pitch = rng.uniform(4e-3, 7e-3), rng.uniform(1e-3, 1.75e-3)

    def heights(u: Array, v: Array) -> Array:
        thread = 0.3 * pitch * (1 - np.cos(2 * np.pi * u / pitch))
        return _round_profile(np.abs(v), radius) + thread

    return Foreign(_field(heights, rng.uniform(0, np.pi)), (1 / radius, np.nan))


def _coin(rng: np.random.Generator) -> Foreign:
    radius, half = float(rng.uniform(8e-3, 13e-3)), float(rng.uniform(0.75e-3, 1.2e-3))
    t = rng.uniform(0, np.pi)
    along = np.array([np.cos(t), np.sin(t), 0.0])
    R = np.column_stack([np.cross([0, 0, 1], along), [0, 0, 1], along])
    return Foreign(
        lambda _, p: [obstacle("cylinder", (radius, half), p + [0, 0, radius], R)],
        (np.nan, 1 / radius),
    )


KINDS: dict[str, Callable[[np.random.Generator], Foreign]] = {
    "ellipsoid 7 x 12 x 19": _ellipsoid,
    "corner": _corner,
    "tilted disc": _tilted_disc,
    "tilted block": _tilted_block,
    "rounded wedge": _rounded_wedge,
    "superquadric": _superquadric,
    "torus": _torus,
    "ball and block": _ball_and_block,
    "screw thread": _screw,
    "coin on its edge": _coin,
}
