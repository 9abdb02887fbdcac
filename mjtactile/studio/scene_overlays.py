"""Overlays in Studio's scene: estimated surfaces, forces, contact outlines, centers of pressure,
estimated shapes, camera frustums."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mjtactile.core.types import Array
from mjtactile.report.shape_wireframe import lines_of
from mjtactile.report.summary_figure import FINGER_COLOURS
from mjtactile.studio import surface_colormap
from mjtactile.studio.snapshot import FingerSnapshot, Pose

_G = mujoco.mjtGeom
_METRES_PER_NEWTON = 0.03  # arrow length per net force, m/N
_FIELD_METRES_PER_NEWTON = 0.15  # arrow length per force of its block of nodes
_ARROWS = (7, 5)  # arrows of the field along x and y
_MIN_ARROW = 1.5e-3  # minimum length of a rendered arrow, m
_OUTLINE = 24  # maximum number of segments of an outline
_ABOVE = 4e-4  # offset of the estimated surface, m, above the simulated one
_DARK = (0.1, 0.1, 0.1, 1.0)
_BODY = (0.1, 0.45, 0.1, 1.0)
_RED = (0.9, 0.2, 0.15, 1.0)


@dataclass(frozen=True)
class OverlayOptions:
    """Selection of overlays: `surface` is "none" or one of `surface.KINDS`."""

    surface: str = "indentation"
    forces: bool = True
    field: bool = False
    contacts: bool = True
    camera: bool = False


class GeomPool:
    """Pool of geoms that are reused in each frame: creating one takes 25 us, changing it 6."""

    def __init__(self) -> None:
        self._made: dict[int, list[mujoco.MjvGeom]] = {}
        self._used: dict[int, int] = {}
        self.geoms: list[mujoco.MjvGeom] = []

    def start(self) -> None:
        """Start a new frame; the geoms of the last frame are reused."""
        self._used = {}
        self.geoms = []

    def triangles(self, corners: Array, rgb: Array) -> None:
        """Add triangles with `corners` (m, 3, 3), m, in W and colors `rgb` (m, 3), 0 to 1."""
        along = corners[:, 1] - corners[:, 0]
        aside = corners[:, 2] - corners[:, 0]
        normal = np.cross(along, aside)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
        rgba = np.column_stack([rgb, np.ones(len(rgb))]).astype(np.float32)
        for corner, axes, shade in zip(
            corners[:, 0], np.stack([along, aside, normal], axis=2), rgba, strict=True
        ):
            geom = self._next(_G.mjGEOM_TRIANGLE)
            geom.pos = corner
            geom.mat = axes
            geom.rgba = shade

    def connect(
        self, kind: mujoco.mjtGeom, width: float, start: Array, end: Array, rgba: Sequence[float]
    ) -> None:
        """Add an arrow (`width` in m) or a line (`width` in px) between two points, m, in W."""
        geom = self._next(kind)
        mujoco.mjv_connector(geom, int(kind), width, start, end)
        geom.rgba = np.array(rgba, dtype=np.float32)

    def ball(self, center: Array, radius: float, rgba: Sequence[float]) -> None:
        geom = self._next(_G.mjGEOM_SPHERE)
        geom.pos = center
        geom.size = np.full(3, radius)
        geom.rgba = np.array(rgba, dtype=np.float32)

    def _next(self, kind: mujoco.mjtGeom) -> mujoco.MjvGeom:
        made = self._made.setdefault(int(kind), [])
        used = self._used.get(int(kind), 0)
        if used == len(made):
            geom = mujoco.MjvGeom()
            mujoco.mjv_initGeom(
                geom,
                int(kind),
                np.ones(3),
                np.zeros(3),
                np.eye(3).ravel(),
                np.ones(4, dtype=np.float32),
            )
            made.append(geom)
        self._used[int(kind)] = used + 1
        self.geoms.append(made[used])
        return made[used]


def update(
    brush: GeomPool,
    fingers: Sequence[FingerSnapshot],
    options: OverlayOptions,
    *,
    minimum: float = 0.0,
) -> None:
    """Render the overlays of all fingers with a known pose.

    Surfaces are restricted to parts above the fraction `minimum` of the color scale (0: all).
    """
    brush.start()
    fields = [
        None if options.surface == "none" else surface_colormap.field_of(estimated, options.surface)
        for estimated in fingers
    ]
    scale = surface_colormap.scale_of(fields)
    for estimated, field, colour in zip(fingers, fields, FINGER_COLOURS, strict=False):
        if estimated.pose is None:
            continue
        if (
            field is not None
            and (found := surface_colormap.surface_geom(estimated, field, scale, minimum=minimum))
            is not None
        ):
            corners, rgb = found
            brush.triangles(estimated.pose.place(corners + [0.0, 0.0, _ABOVE]), rgb)
        if estimated.touch.touching:
            _touches(
                brush,
                estimated,
                estimated.pose,
                options,
                [*(int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)), 1.0],
            )
        if options.camera and estimated.design is not None:
            _camera(brush, estimated, estimated.pose)


def _touches(
    brush: GeomPool,
    estimated: FingerSnapshot,
    pose: Pose,
    options: OverlayOptions,
    rgba: Sequence[float],
) -> None:
    """Render a finger's outlines, shape, center of pressure, net force and force field."""
    centre = surface_colormap.centre_of_pressure(estimated.touch)
    if options.contacts:
        for patch in estimated.touch.patches:
            if len(patch.outline):
                _outline(brush, estimated, pose, patch.outline)
        if estimated.touch.shape is not None:
            for line in lines_of(estimated.touch.shape):
                _line(brush, pose.place(line))
        if centre is not None:
            brush.ball(pose.place(_above_surface(estimated, centre[None]))[0], 8e-4, _RED)
    if estimated.touch.traction is None:
        return
    if (
        options.forces
        and centre is not None
        and np.isfinite(estimated.touch.traction.wrench[:3]).all()
    ):
        tip = pose.place(_above_surface(estimated, centre[None]))[0]
        push = -pose.R_WS @ estimated.touch.traction.wrench[:3]
        brush.connect(_G.mjGEOM_ARROW, 0.002, tip - _METRES_PER_NEWTON * push, tip, rgba)
    if options.field:
        _field(brush, estimated, pose, rgba)


def _above_surface(estimated: FingerSnapshot, p_S: Array) -> Array:
    return surface_colormap.height_at(estimated.touch, p_S) + [0.0, 0.0, 2 * _ABOVE]


def _outline(brush: GeomPool, estimated: FingerSnapshot, pose: Pose, outline: Array) -> None:
    every = -(-len(outline) // _OUTLINE)
    points = pose.place(_above_surface(estimated, outline[::every]))
    for a, b in zip(points, np.roll(points, -1, axis=0), strict=True):
        brush.connect(_G.mjGEOM_LINE, 3.0, a, b, _DARK)


def _line(brush: GeomPool, points: Array) -> None:
    """Render a line of the estimated shape. The ground truth is in the scene."""
    every = -(-len(points) // _OUTLINE)
    points = np.concatenate([points[:-1:every], points[-1:]])
    for a, b in zip(points[:-1], points[1:], strict=True):
        brush.connect(_G.mjGEOM_LINE, 3.0, a, b, _BODY)


def _field(brush: GeomPool, estimated: FingerSnapshot, pose: Pose, rgba: Sequence[float]) -> None:
    """Render the traction field, as exerted by the membrane: an arrow for each block of nodes."""
    t = estimated.touch.traction
    assert t is not None
    for rows in np.array_split(np.arange(len(t.y)), _ARROWS[1]):
        for columns in np.array_split(np.arange(len(t.x)), _ARROWS[0]):
            push = -t.force[np.ix_(rows, columns)].sum(axis=(0, 1))
            if np.linalg.norm(push) * _FIELD_METRES_PER_NEWTON > _MIN_ARROW:
                tip = pose.place(
                    _above_surface(estimated, np.array([[t.x[columns].mean(), t.y[rows].mean()]]))
                )[0]
                brush.connect(
                    _G.mjGEOM_ARROW,
                    8e-4,
                    tip - _FIELD_METRES_PER_NEWTON * pose.R_WS @ push,
                    tip,
                    rgba,
                )


def _camera(brush: GeomPool, estimated: FingerSnapshot, pose: Pose) -> None:
    """Render the camera's frustum, from its center to the plane of the flat membrane."""
    camera = estimated.design.camera
    corners = (
        np.array([[0, 0], [camera.width, 0], [camera.width, camera.height], [0, camera.height]])
        - 0.5
    )
    plain = (corners - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    rays = camera.lens.undistort(plain)
    rays = np.where(np.isfinite(rays), rays, plain)  # a lens that folds over before the corner
    eye = pose.place(camera.p_SC)
    base = pose.place(np.column_stack([camera.distance * rays, np.zeros(4)]))
    for a, b in zip(base, np.roll(base, -1, axis=0), strict=True):
        brush.connect(_G.mjGEOM_LINE, 2.0, eye, a, _DARK)
        brush.connect(_G.mjGEOM_LINE, 2.0, a, b, _DARK)


def keep(
    geoms: list[mujoco.MjvGeom],
    mine: list[mujoco.MjvGeom],
    added: list[mujoco.MjvGeom],
    maximum: int,
) -> None:
    """Replace `mine` by `added` in the viewer's list, up to `maximum` geoms in total.

    The list also holds geoms of other plugins.
    """
    geom_ids = {id(geom) for geom in mine}
    geoms[:] = [geom for geom in geoms if id(geom) not in geom_ids]
    geoms += added[: max(0, maximum - len(geoms))]
