"""Graphics of a cycle for a viewer: ellipses, membranes, force arrows and a simulated scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, Ellipses, Surface, Traction
from mjtactile.export.episode import Perceived, RecordedEpisode
from mjtactile.export.frames import Transform
from mjtactile.export.messages import Message, Source, of_cycle, stamp_of, static
from mjtactile.sensing.image.ellipse import boundary, shape_from_axes

FORCE = 0.02  # arrow length per force, m/N
TRACTION = 2e-6  # arrow length per traction, m/Pa
MEMBRANE = (0.62, 0.78, 0.95, 1.0)
TRUSTED = (0.22, 0.83, 0.33, 1.0)
FLAGGED = (0.9, 0.24, 0.24, 1.0)
PRESSED = (0.86, 0.31, 0.17, 1.0)
_TRACTION_MIN = 0.03  # minimum plotted traction, as a fraction of the largest
_AROUND = 24  # points of an ellipse


@dataclass(frozen=True, eq=False)
class ImageCurves:
    """Closed curves (n, k, 2) in an image, px, and whether each is trusted."""

    points: Array
    trusted: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class RenderedMesh:
    """A surface in its frame: points (n, 3) m, triangles (m, 3), colour from 0 to 1."""

    points: Array
    triangles: Array
    rgba: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Arrows:
    """Arrows in their frame: `tails` (n, 3) m, `vectors` (n, 3) m in displayed length."""

    tails: Array
    vectors: Array
    rgba: tuple[float, ...]


@dataclass(eq=False)
class EntityStream:
    """Viewer items of the cycles. Each scene body is sent once, then only its motion."""

    source: Source
    _placed: dict[str, Array] = field(default_factory=dict)

    def again(self) -> None:
        """Send the whole scene again with the next cycle, for a new viewer."""
        self._placed.clear()

    def of(self, perceived: Perceived) -> Iterator[Message]:
        """Yield all viewer items of one cycle."""
        for k, finger in enumerate(self.source.fingers):
            stamp = stamp_of(perceived, k)
            sensor = f"{finger}_sensor"
            ellipses = perceived.ellipses[k] if perceived.ellipses else None
            if ellipses is not None and len(ellipses):
                camera = f"{finger}_camera"
                yield Message(f"/{finger}/ellipses", "curves", stamp, camera, curves_of(ellipses))
            touch = perceived.touch[k] if perceived.touch else None
            if touch is None or touch.surface is None:
                continue
            mesh = surface_mesh(touch.surface)
            yield Message(f"/{finger}/membrane/drawn", "mesh", stamp, sensor, mesh)
            if touch.traction is not None:
                arrows = traction_arrows(touch.traction, touch.surface)
                yield Message(f"/{finger}/traction/drawn", "arrows", stamp, sensor, arrows)
                force = force_arrow(touch.traction, touch.surface)
                yield Message(f"/{finger}/force/drawn", "arrows", stamp, sensor, force)
        if perceived.view is not None:
            yield from self._scene(perceived)

    def _scene(self, perceived: Perceived) -> Iterator[Message]:
        moved = []
        for solid in perceived.view.solids():
            frame = f"scene/{solid.name}"
            pose = np.append(solid.R_WG.ravel(), solid.p_WG)
            before = self._placed.get(frame)
            if before is None:
                mesh = RenderedMesh(solid.points, solid.faces, tuple(map(float, solid.rgba)))
                yield Message(f"/{frame}", "mesh", perceived.time, frame, mesh)
            if before is None or not np.array_equal(before, pose):
                moved.append(Transform("world", frame, solid.R_WG, solid.p_WG))
                self._placed[frame] = pose
        for name, points, faces, rgba in perceived.view.soft_bodies():
            mesh = RenderedMesh(points, faces, tuple(map(float, rgba)))
            yield Message(f"/soft/{name}", "mesh", perceived.time, "world", mesh)
        if moved:
            yield Message("/tf_scene", "frames", perceived.time, "", moved)


def rendered_items(episode: RecordedEpisode) -> Iterator[Message]:
    """Yield all messages of a recording and the graphics of each cycle."""
    entities = EntityStream(episode)
    yield static(episode, float(episode.recording.columns["time"][0]))
    for perceived in episode.cycles():
        yield from of_cycle(episode, perceived)
        yield from entities.of(perceived)


def curves_of(ellipses: Ellipses) -> ImageCurves:
    """Return the ellipses of an image as closed curves; those without status "ok" are untrusted."""
    shapes = shape_from_axes(ellipses.semi_axes_px, ellipses.angle)
    points, _ = boundary(ellipses.center_px, shapes, _AROUND)
    return ImageCurves(np.concatenate([points, points[:, :1]], axis=1), ellipses.status == "ok")


def surface_mesh(surface: Surface) -> RenderedMesh:
    """Triangulate a membrane: two triangles between four neighbors of its grid."""
    x, y = np.meshgrid(surface.x, surface.y)
    rows, columns = x.shape
    corner = np.arange(rows * columns).reshape(rows, columns)
    a = corner[:-1, :-1].ravel()
    b = corner[:-1, 1:].ravel()
    c = corner[1:, 1:].ravel()
    d = corner[1:, :-1].ravel()
    triangles = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    points = np.column_stack([x.ravel(), y.ravel(), surface.z.ravel()])
    return RenderedMesh(points, triangles, MEMBRANE)


def traction_arrows(traction: Traction, surface: Surface) -> Arrows:
    """Return arrows of the traction at the loaded nodes, with tips on the membrane."""
    x, y = np.meshgrid(traction.x, traction.y)
    node_area = (traction.x[1] - traction.x[0]) * (traction.y[1] - traction.y[0])
    pressure = traction.force.reshape(-1, 3) / node_area
    size = np.linalg.norm(pressure, axis=1)
    estimated = size > _TRACTION_MIN * max(float(np.nanmax(size, initial=0.0)), 1e-9)
    at = np.column_stack([x.ravel(), y.ravel()])[estimated]
    tips = np.column_stack([at, _height(surface, at)])
    vectors = TRACTION * pressure[estimated]
    return Arrows(tips - vectors, vectors, PRESSED)


def force_arrow(traction: Traction, surface: Surface) -> Arrows:
    """Return an arrow of the net force on the membrane; none for an unknown or tiny force.

    Its tip is the center of pressure, (x, y) = (-t_y, t_x) / f_z.
    """
    force = traction.wrench[:3]
    if not np.isfinite(traction.wrench).all() or abs(force[2]) < 0.02:
        return Arrows(np.zeros((0, 3)), np.zeros((0, 3)), PRESSED)
    torque = traction.wrench[3:]
    at = np.array([[-torque[1], torque[0]]]) / force[2]
    at = np.clip(at, [surface.x[0], surface.y[0]], [surface.x[-1], surface.y[-1]])
    tip = np.column_stack([at, _height(surface, at)])
    vector = FORCE * force[None]
    return Arrows(tip - vector, vector, PRESSED)


def _height(surface: Surface, at: Array) -> Array:
    """Return the membrane's height z (n,), m, at the nodes nearest to (n, 2), m."""
    column = np.abs(surface.x[None] - at[:, :1]).argmin(axis=1)
    row = np.abs(surface.y[None] - at[:, 1:]).argmin(axis=1)
    return surface.z[row, column]
