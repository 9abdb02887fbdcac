"""Shadows: the LEDs light the deformed membrane, and obstacles block part of the light.

The equations are Eq. L1-L4. The renderer receives the membrane only as marker positions. The
membrane is the thin-plate spline that interpolates their displacements. It is fixed to the frame.
On the shipped layouts its resolution equals that of the simulation mesh.

The spline gives a height field on a regular grid of the opening. Each LED's irradiance with the
slope's cosine is computed on that grid. The clearance of each LED's ray is computed too, over the
membrane and past the frame's inner wall. Camera rays are intersected with the deformed height
field. Light therefore moves in the image with the surface.

Left out:

- refraction of the LEDs' light in the glass (it seems to come from 0.7 mm closer);
- light scattered within the rubber (it softens edges by about a thickness);
- overhanging membranes, which a height field cannot represent.
"""

from __future__ import annotations

import cv2
import numpy as np

from mjtactile.core import optics
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.optics import Camera
from mjtactile.core.sensor_parts import Frame
from mjtactile.core.types import Array
from mjtactile.kernels import kernel
from mjtactile.sim.rendering.led_illumination import BLOCK_PX, Floats, Light, block_slopes

LED_RADIUS = 1.5e-3
"""Radius, m, of an LED's luminous window (packages 3528 and 5050), which makes the penumbra."""
# node spacing of the height field, m; half of it moves shadow edges by 0.1 mm
# (tests/unit/sim/test_shadows.py)
_NODE = 1e-3
_EDGE_PX = 4  # blocks where a shadow falls: 0.3 mm of membrane; edges are soft over 0.1-0.5 mm
# fixed point: ray against height field; each halves the rest even at the corner and a slope of 45
# degrees
_CAMERA_STEPS = 6
# fixed point: material point at a position; displacements change by 0.2 per length
_CARRY_STEPS = 4
# convergence step of both fixed points, m: the remaining error is below half of it, 0.2 px
_NEAR = 2e-5
# ray length relative to that down to the membrane's lowest point; the excess is for the penumbra
_BEYOND = 1.1
_MAX_STEPS = 200  # maximum samples along a ray: 0.1 m of length at the usual node spacing


class ShadowedLight(Light):
    """`Light` on the membrane through the markers, with local cosine and shadow of each LED.

    If the design's vignetting is less than that of the LEDs, the difference is uniform light.
    """

    def __init__(self, design: SensorDesign, camera: Camera):
        super().__init__(design, camera)
        self._membrane = SmoothMembrane(design)
        self._p_SL = np.column_stack([self._leds, np.full(len(self._leds), -self._distance)])
        loss = float(self._loss)
        self._direct = self._falloff / loss if loss > self._falloff else float(self._falloff > 0)
        self._depth = design.chamber.depth
        self._camera = camera
        self._outside = bool((edge_distance(design.frame, self._leds) < LED_RADIUS).any())
        self._views = {block: self._lines(block) for block in (BLOCK_PX, _EDGE_PX)}
        # Beyond the opening the camera sees the frame's wall, which stays where it is.
        rim = edge_distance(design.frame, self._line(*self._lines(1), np.zeros(1)))
        self._opening = (rim > 0).astype(np.float32)
        self._wall = super().field(np.zeros((0, 3))) * (1 - self._opening)

    def field(self, p_SM: Array) -> Floats:
        """Return the relative light (H, W) on a membrane with all markers at `p_SM` (N, 3)."""
        if self._even:
            return np.ones(self._size[::-1], np.float32)
        membrane = self._membrane
        z = membrane.heights(p_SM)
        light = irradiance(membrane.xy, z, self._p_SL)
        total = light.sum(axis=0)
        fraction = bilinear(total / self._middle, self._pixel_coordinates(z, BLOCK_PX)).astype(
            np.float32
        )
        field = self._grow(np.maximum(1 - self._falloff / float(self._loss) * (1 - fraction), 0.0))
        blocked = self._blocked(z, light / np.maximum(total, 1e-12))
        if blocked is not None:
            field -= np.minimum(self._direct * self._grow(fraction), field) * blocked
        return cv2.add(cv2.multiply(field, self._opening), self._wall)

    def _blocked(self, z: Array, light: Array) -> Floats | None:
        """Return the blocked fraction (H, W) of the LEDs' `light` (n, ny, nx); None: none."""
        membrane = self._membrane
        clear = None
        if may_block(membrane.xy, z, self._p_SL):
            clear = clearance(membrane.xy, z, self._p_SL)
        if self._outside:
            wall = wall_clearance(membrane.frame, self._depth, membrane.xy, z, self._p_SL)
            clear = wall if clear is None else np.minimum(clear, wall)
        if clear is None or clear.min() >= 1:
            return None
        column, row = np.moveaxis(self._pixel_coordinates(z, _EDGE_PX).astype(np.float32), -1, 0)
        blocked = np.zeros(column.shape, np.float32)
        for fraction, room in zip(light.astype(np.float32), clear.astype(np.float32), strict=True):
            # the clearance is interpolated, not the light: edges are finer than the nodes
            if room.min() < 1:
                hidden = 1 - visible(cv2.remap(room, column, row, cv2.INTER_LINEAR))
                blocked += cv2.remap(fraction, column, row, cv2.INTER_LINEAR) * hidden
        return self._grow(blocked)

    def _grow(self, blocks: Array | Floats) -> Floats:
        """Interpolate values of blocks (nv, nu) to an image (H, W)."""
        return cv2.resize(
            blocks.astype(np.float32, copy=False), self._size, interpolation=cv2.INTER_LINEAR
        )

    def _lines(self, block: int) -> tuple[Array, Array]:
        """Return ray slopes (nv, nu, 2), in C, and apparent depth offsets (nv, nu) per block."""
        slopes = block_slopes(self._camera, block)
        return slopes, optics.glass_displacement(self._camera, (slopes**2).sum(axis=-1))

    def _pixel_coordinates(self, z: Array, block: int) -> Array:
        """Return columns and rows (nv, nu, 2) of the height field `z` in pixel blocks."""
        slopes, shift = self._views[block]
        # heights of the large blocks do: 0.001 of light at the worst, in a dent of 9 mm
        if block != BLOCK_PX:
            near = bilinear(z, self._pixel_coordinates(z, BLOCK_PX))
            height = cv2.resize(near, shift.shape[::-1], interpolation=cv2.INTER_LINEAR)
            return self._membrane.columns_rows(self._line(slopes, shift, height))
        height = np.zeros(shift.shape)
        at = self._membrane.columns_rows(self._line(slopes, shift, height))
        for _ in range(_CAMERA_STEPS):
            last = height
            height = bilinear(z, at)
            at = self._membrane.columns_rows(self._line(slopes, shift, height))
            if np.abs(height - last).max() < _NEAR:
                break
        return at

    def _line(self, slopes: Array, shift: Array, height: Array) -> Array:
        """Return the points x, y (..., 2) m of rays (of `_lines`) at a `height` m in S."""
        return slopes * (self._distance + height - shift)[..., None]


class SmoothMembrane:
    """Smooth membrane through the markers, fixed to the frame, on a grid `xy` (ny, nx, 2) m."""

    def __init__(self, design: SensorDesign):
        self.frame = frame = design.frame
        self.x, self.y = (
            np.linspace(-side / 2, side / 2, round(side / _NODE) + 1)
            for side in (frame.length, frame.width)
        )
        self.xy = np.stack(np.meshgrid(self.x, self.y), axis=-1)
        self._flat = design.markers.p_SM
        rim = _rim(frame)
        known = np.concatenate([self._flat[:, :2], rim])
        values = np.eye(len(known))[:, : len(self._flat)]
        from scipy.interpolate import RBFInterpolator  # imported lazily: few images have shadows

        operator = RBFInterpolator(known, values, kernel="thin_plate_spline")(
            self.xy.reshape(-1, 2)
        )
        operator[edge_distance(frame, self.xy.reshape(-1, 2)) <= 0] = 0.0
        self._operator = operator

    def columns_rows(self, xy: Array) -> Array:
        """Convert positions (..., 2), m, to fractional columns and rows of the grid."""
        first = self.xy[0, 0]
        last = self.xy[-1, -1]
        return (xy - first) * (np.array([len(self.x), len(self.y)]) - 1) / (last - first)

    def heights(self, p_SM: Array) -> Array:
        """Return the heights (ny, nx), m, of the membrane for markers at `p_SM` (N, 3).

        The material point X with X + u(X) = x is at x.
        """
        if p_SM.shape != self._flat.shape or not np.isfinite(p_SM).all():
            raise InputError(
                f"shadows need the positions of all {len(self._flat)} markers of the design",
                field="shadows",
            )
        moved = (self._operator @ (p_SM - self._flat)).reshape(*self.xy.shape[:2], 3)
        found = moved
        for _ in range(_CARRY_STEPS):
            last = found
            found = bilinear(moved, self.columns_rows(self.xy - found[..., :2]))
            if np.abs(found - last).max() < _NEAR:
                break
        return found[..., 2]


# -- light and shadow on a height field: xy (ny, nx, 2), z (ny, nx), LEDs p_SL (n, 3), all m in S
# ---------------------


def irradiance(xy: Array, z: Array, p_SL: Array) -> Array:
    """Return each LED's irradiance without obstruction (n, ny, nx), 1/m^2 (Eq. L1)."""
    dz_dy, dz_dx = np.gradient(z, xy[:, 0, 1], xy[0, :, 0])
    to_x, to_y, down = _towards(xy, z, p_SL)
    # distance x cosine
    facing = (to_x * dz_dx + to_y * dz_dy + down) / np.sqrt(1 + dz_dx**2 + dz_dy**2)
    return down * np.maximum(facing, 0.0) / (to_x**2 + to_y**2 + down**2) ** 2


def may_block(xy: Array, z: Array, p_SL: Array) -> bool:
    """Return True if the membrane's steepest slope exceeds the lowest ray (Eq. L2)."""
    along_x, along_y = (
        np.abs(np.diff(z, axis=a)) / (xy[1, 1, 1 - a] - xy[0, 0, 1 - a]) for a in (1, 0)
    )
    steepest = np.hypot(
        np.maximum(along_x[1:], along_x[:-1]), np.maximum(along_y[:, 1:], along_y[:, :-1])
    ).max()
    to_x, to_y, down = _towards(xy, z, p_SL)
    return bool(steepest > (down / (np.hypot(to_x, to_y) + LED_RADIUS)).min())


def clearance(xy: Array, z: Array, p_SL: Array, radius: float = LED_RADIUS) -> Array:
    """Return the clearance (n, ny, nx) of each LED's center over the membrane, in radii (Eq. L3).

    At 1 and above the LED is fully visible. At -1 and below it is fully hidden.
    """
    to_x, to_y, down = _towards(xy, z, p_SL)
    across = np.hypot(to_x, to_y)
    end = np.minimum(_BEYOND * np.maximum(z - z.min(), 1e-9) / down, 1.0)
    sample = min(xy[1, 1] - xy[0, 0]) / 2
    steps = int(np.clip(np.ceil((end * across).max() / sample), 1, _MAX_STEPS))
    first = xy[0, 0]
    scale = 1 / (xy[1, 1] - xy[0, 0])
    minimum = np.full(down.shape, np.inf)
    for k in range(1, steps + 1):
        part = end * (k / steps)
        x = xy[..., 0] + part * to_x
        y = xy[..., 1] + part * to_y
        at = np.stack([(x - first[0]) * scale[0], (y - first[1]) * scale[1]], axis=-1)
        np.minimum(minimum, (bilinear(z, at) - z) / part, out=minimum)
    # membrane directly below an LED is not shadowed
    return (minimum + down) / down * np.maximum(across, 2 * radius) / radius


def wall_clearance(frame: Frame, depth: float, xy: Array, z: Array, p_SL: Array) -> Array:
    """Return the clearance over the frame's inner wall, down to the glass at `depth` m (Eq. L4)."""
    to_x, to_y, down = _towards(xy, z, p_SL)
    part = (z + depth) / down
    crossing = np.stack([xy[..., 0] + part * to_x, xy[..., 1] + part * to_y], axis=-1)
    return edge_distance(frame, crossing) / (np.maximum(part, 1e-9) * LED_RADIUS)


def visible(clear: Array | Floats) -> Floats:
    """Return the visible fraction of an LED at a `clearance`."""
    return np.clip((1 + clear) / 2, 0.0, 1.0).astype(np.float32)


def edge_distance(frame: Frame, xy: Array) -> Array:
    """Return the distance (...), m, of positions (..., 2) from the opening's edge; positive
    inside."""
    if frame.outline is not None:
        return frame.inside(xy.reshape(-1, 2)).reshape(xy.shape[:-1])
    return np.minimum(frame.length / 2 - np.abs(xy[..., 0]), frame.width / 2 - np.abs(xy[..., 1]))


def bilinear(grid: Array, columns_rows: Array) -> Array:
    """Interpolate `grid` (ny, nx, ...) at fractional columns and rows (..., 2)."""
    out = np.empty((*columns_rows.shape[:-1], *grid.shape[2:]))
    count = columns_rows.size // 2
    kernel("bilinear")(*grid.shape[:2], out.size // max(count, 1), grid, count, columns_rows, out)
    return out


def _towards(xy: Array, z: Array, p_SL: Array) -> tuple[Array, Array, Array]:
    """Return the offsets (n, ny, nx), m, from each node to each LED: along x and y, and down."""
    to_x, to_y = (p_SL[:, i, None, None] - xy[..., i] for i in (0, 1))
    return to_x, to_y, z - p_SL[:, 2, None, None]


def _rim(frame: Frame, spacing: float = 2.5e-3) -> Array:
    """Return points (n, 2), m, on the opening's edge, closer together than the markers of any
    layout."""
    if frame.outline is not None:
        longest = np.pi * np.hypot(frame.length, frame.width) / np.sqrt(2)
        return frame.outline.points(int(np.ceil(longest / spacing)))
    x = frame.length / 2
    y = frame.width / 2
    corners = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    sides = []
    for start, stop in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        count = int(np.ceil(np.linalg.norm(stop - start) / spacing))
        sides.append(np.linspace(start, stop, count, endpoint=False))
    return np.concatenate(sides)
