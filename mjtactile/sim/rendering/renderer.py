"""Virtual camera: an exact analytic renderer of rigid marker circles on the membrane; needs no
OpenGL.

Every circle is projected exactly through its pose, the glass and the lens. Its boundary in the
image is then a smooth closed curve. The point spread function consists of the camera's Gaussian
blur and the pixel's square. The area under it is integrated along that curve, without any sampling
of the area: see `render_discs`. Not modeled: marker thickness, specular reflections, light
reflected by the walls. The illumination comes from the LEDs, see led_illumination.py and
shadows.py.

This module shares no code with `sensing`, so that a mistake cannot cancel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjtactile.core import optics
from mjtactile.core.design import SensorDesign
from mjtactile.core.optics import Camera
from mjtactile.core.types import Array, Image
from mjtactile.kernels import kernel
from mjtactile.sim.rendering.fiducials import FiducialRenderer
from mjtactile.sim.rendering.led_illumination import Light
from mjtactile.sim.rendering.shadows import ShadowedLight

# grey level of the frame's inner wall against the membrane's: matte, clearly neither of the two
_WALL_FRACTION = 0.45
BLUR_MIN_PX = 0.2
"""Minimum blur, px; a smaller one is rendered as this one."""
# quadrature step along an edge, in sd of the blur: exp(-2 pi^2 / 1.25^2) = 3e-6 of aliasing
_STEP_PER_BLUR = 1.25
_OUTLINE = 360  # corners of the polygon in a round opening: 0.01 px of `round30`
_NODES = 4  # quadrature points in each panel of a straight side
# positions per pixel at which the edge functions are tabulated: random error of at most 1e-3 px
_BINS = 512
_TAIL = 5.0  # sd at which the Gaussian ends: 3e-7 of it are beyond
_POOL_FRAMES = 4  # size of the noise pool, in frames; noise is taken from a random position in it

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Effects:
    """Changes to the design's camera for one image: exposure `gain`, `noise_dn`, `blur_px` (sd)."""

    gain: float = 1.0
    noise_dn: float | None = None
    blur_px: float | None = None


class Renderer:
    """Renderer of the images of `design`'s camera; `seed` fixes the noise.

    `radius` m of the markers, one or one each, and `pose` R_SC (3, 3), p_SC (3,) m of the camera
    with its glass and LEDs default to the design's. With `shadows` the LEDs light the deformed
    membrane, including shadows. All markers of the design must then be given.
    """

    def __init__(
        self,
        design: SensorDesign,
        *,
        radius: ArrayLike | None = None,
        seed: int = 0,
        shadows: bool = False,
        pose: tuple[Array, Array] | None = None,
    ):
        self.design = design
        self._R_SC, self._p_SC = (np.eye(3), design.camera.p_SC) if pose is None else pose
        self.camera = Camera.from_design(design.camera, design.glass)
        self.radius = np.asarray(design.markers.radius if radius is None else radius, dtype=float)
        self._light = (ShadowedLight if shadows else Light)(design, self.camera)
        self._rng = np.random.default_rng(seed)
        pixels = self.camera.width * self.camera.height
        pool = self._rng.standard_normal(_POOL_FRAMES * pixels, dtype=np.float32)
        self._noise: Floats = (pool - pool.mean()) / pool.std()
        self._bare: dict[float, Floats] = {}
        self._fixed = FiducialRenderer.of(design)

    def reseed(self, seed: int) -> None:
        """Set the generator that selects the noise of the images from the pool."""
        self._rng = np.random.default_rng(seed)

    def render(
        self,
        p_SM: ArrayLike,
        n_S: ArrayLike,
        time: float = 0.0,
        *,
        rng: np.random.Generator | None = None,
        effects: Effects = Effects(),
    ) -> Image:
        """Render the image of markers with centres `p_SM` (N, 3) m and normals `n_S` (N, 3), in S.

        The normals may have either sign. Noise comes from `rng`, or from the renderer.
        """
        return self.expose(
            self.irradiance_image(p_SM, n_S, effects=effects), time, rng=rng, effects=effects
        )

    def expose(
        self,
        gray: Floats,
        time: float = 0.0,
        *,
        rng: np.random.Generator | None = None,
        effects: Effects = Effects(),
    ) -> Image:
        """Return the image of grey levels `gray` (H, W): with noise, rounded."""
        noise_dn = self.design.camera.noise_dn if effects.noise_dn is None else effects.noise_dn
        start = 0
        sign = 0
        if noise_dn > 0:
            rng = self._rng if rng is None else rng
            start = int(rng.integers(len(self._noise) - gray.size + 1))
            sign = 1 if rng.random() < 0.5 else -1
        pixels = np.empty(gray.shape, np.uint8)
        kernel("expose")(
            gray.size, gray, self._noise[start : start + gray.size], sign * noise_dn, pixels
        )
        return Image(pixels, time)

    def irradiance_image(
        self, p_SM: ArrayLike, n_S: ArrayLike, *, effects: Effects = Effects()
    ) -> Floats:
        """Render gray levels (H, W), float32, before noise and rounding. See `render`."""
        blur = self.design.camera.blur_px if effects.blur_px is None else effects.blur_px
        p_SM = np.asarray(p_SM, dtype=float).reshape(-1, 3)
        n_S = np.asarray(n_S, dtype=float).reshape(-1, 3)
        gray = np.zeros((self.camera.height, self.camera.width), np.float32)
        render_discs(
            self.camera, (p_SM - self._p_SC) @ self._R_SC, n_S @ self._R_SC, self.radius, blur, gray
        )
        kernel("shade")(
            gray.size,
            self.design.leds.marker_dn,
            effects.gain,
            self._contrast(blur),
            self._light.field(p_SM),
            gray,
        )
        return gray

    def _contrast(self, blur: float) -> Floats:
        """Return the excess of membrane and wall over a marker, (H, W) DN."""
        if blur not in self._bare:
            membrane = self.design.leds.membrane_dn
            marker = self.design.leds.marker_dn
            white = self._polygon(_opening(self.design), blur)
            black = None
            if self._fixed is not None:
                white, black = self._with_fixed(self._fixed, white, blur)
            bare = membrane * (_WALL_FRACTION + (1 - _WALL_FRACTION) * white) - marker
            if black is not None:
                bare *= 1 - black
            self._bare[blur] = bare.astype(np.float32)
        return self._bare[blur]

    def _with_fixed(
        self, fixed: FiducialRenderer, white: Floats, blur: float
    ) -> tuple[Floats, Floats]:
        """Return the `white` area (H, W) with the fiducials' ground, and their black area."""
        blur = max(blur, fixed.blur_px)
        if fixed.white is None:
            ground = self._discs(fixed, fixed.radius + fixed.ground, blur)
        else:
            outer, inner = (self._polygon(outline, blur) for outline in fixed.white)
            ground = outer - inner
        return np.maximum(white, ground), self._discs(fixed, fixed.radius, blur)

    def _discs(self, fixed: FiducialRenderer, radius: float, blur: float) -> Floats:
        p_CF = (fixed.p_SF - self._p_SC) @ self._R_SC
        coverage = np.zeros((self.camera.height, self.camera.width), np.float32)
        render_discs(self.camera, p_CF, fixed.n_S @ self._R_SC, radius, blur, coverage)
        return np.clip(coverage, 0.0, 1.0)

    def _polygon(self, corners_SP: Array, blur: float) -> Floats:
        coverage = np.zeros((self.camera.height, self.camera.width), np.float32)
        render_opening(self.camera, (corners_SP - self._p_SC) @ self._R_SC, blur, coverage)
        return coverage


def render_discs(
    camera: Camera, p_CM: Array, n_C: Array, radius: ArrayLike, blur_px: float, coverage: Floats
) -> None:
    """Add the blurred area coverage (0-1) of N discs to the image `coverage` (H, W).

    Centers `p_CM` (N, 3) m and unit normals `n_C` (N, 3) of either sign are in C. `radius` m is one
    value or (N,). Discs behind the camera, not wholly beyond the glass, or not finite are left out.

    The point spread function is h(u) h(v), h = pixel * Gaussian, and H is its integral. Green's
    theorem gives

        coverage(u, v) = integral over the inside of h(u - x) h(v - y) dx dy = closed integral of
        h(u - x) H(v - y) dx.

    The integrand is smooth, so that the trapezium rule converges exponentially. Each node adds

        h(u - x) (H(v - y) - H(v - 1 - y)) dx

    to the few pixels around it. The sum of the rows above is the coverage. The sign is the curve's
    orientation.
    """
    radius = np.broadcast_to(np.asarray(radius, dtype=float), (len(p_CM),))
    per_px = 1 / (_STEP_PER_BLUR * max(blur_px, BLUR_MIN_PX))
    kernel("render_discs")(
        len(p_CM),
        p_CM,
        n_C,
        radius,
        camera.parameters,
        per_px,
        *_brush(blur_px),
        *coverage.shape,
        coverage,
    )


def render_opening(camera: Camera, corners_CP: Array, blur_px: float, coverage: Floats) -> None:
    """Add the blurred area coverage of the polygon `corners_CP` (M, 3) m in C to `coverage`.

    Glass and lens distort the sides, along which Gauss-Legendre quadrature is used.
    """
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    # px: closer than a rim's, since nodes are not even
    spacing = min(_STEP_PER_BLUR / 2 * max(blur_px, BLUR_MIN_PX), 0.5)
    panels = int(np.ceil(max(camera.width, camera.height) / (_NODES * spacing)))
    t = ((np.arange(panels)[:, None] + (node + 1) / 2) / panels).ravel()[:, None]
    start = corners_CP[:, None]
    side = (np.roll(corners_CP, -1, axis=0) - corners_CP)[:, None]
    h = 1e-5  # of a side; the curve is smooth: truncation h^2
    uv, ahead, behind = (
        optics.project(camera, start + side * s).reshape(-1, 2) for s in (t, t + h, t - h)
    )
    run = (
        (ahead - behind)[:, 0] / (2 * h) * np.tile(weight, panels * len(corners_CP)) / (2 * panels)
    )
    kernel("fill_curve")(len(uv), uv, run, *_brush(blur_px), *coverage.shape, coverage)


@lru_cache(maxsize=32)
def _brush(blur_px: float) -> tuple[int, int, Floats, Floats]:
    """Return the contribution of a node to the pixels around it, for `_BINS` subpixel positions.

    The results are the numbers of bins and pixels, h across (bins, pixels), and the increase of H
    from row to row (bins, pixels + 1). The first pixel is pixels/2 - 1 before the node's.
    """
    sd = max(blur_px, BLUR_MIN_PX)
    taps = 8 * int(np.ceil((_TAIL * sd + 0.5) / 4))  # whole vectors
    d = np.arange(taps + 1) - (taps // 2 - 1) - np.arange(_BINS)[:, None] / _BINS
    edge = np.stack([d + 0.5, d - 0.5, d - 1.5])
    fraction = _normal_cdf(edge / sd)
    integral = edge * fraction + sd * np.exp(-0.5 * (edge / sd) ** 2) / np.sqrt(2 * np.pi)
    across = fraction[0] - fraction[1]
    down = integral[0] - 2 * integral[1] + integral[2]
    return (
        _BINS,
        taps,
        np.ascontiguousarray(across[:, :taps], np.float32),
        np.ascontiguousarray(down, np.float32),
    )


def _normal_cdf(x: Array) -> Array:
    """Return the normal distribution below each `x`; importing scipy's `ndtr` takes 0.2 s."""
    root = math.sqrt(0.5)
    fractions = [0.5 * math.erfc(-root * value) for value in x.ravel().tolist()]
    return np.reshape(fractions, x.shape)


def _opening(design: SensorDesign) -> Array:
    """Return the corners of the frame's opening in S, (n, 3)."""
    if design.frame.outline is not None:
        return np.pad(design.frame.outline.points(_OUTLINE), ((0, 0), (0, 1)))
    x = design.frame.length / 2
    y = design.frame.width / 2
    return np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
