"""Surface reconstruction from markers by the method of the paper (II-B.3).

Marker centers and points on the frame are connected by Delaunay triangulation. Then follow
barycentric interpolation on a Cartesian grid and a B-spline surface through it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.bspline import Cubic
from mjtactile.core.design import SensorDesign
from mjtactile.core.sensor_parts import Frame
from mjtactile.core.types import Array, Surface
from mjtactile.sensing.settings import DEFAULTS
from mjtactile.sensing.surface.surface import GAUSS, check_markers, grid_of


def reconstruct_delaunay(design: SensorDesign, p_SM: ArrayLike) -> Surface:
    """Reconstruct the surface as in the paper: triangles, barycentric grid with the frame as
    boundary, B-spline. `p_SM` is (N, 3), m. The "low resolution" grid of the spline has half the
    marker pitch. The paper gives no uncertainty: `area_sd` and `volume_sd` are NaN."""
    # lazily: only the paper's route needs it
    from scipy.interpolate import LinearNDInterpolator, RectBivariateSpline

    p_SM = np.asarray(p_SM, dtype=float).reshape(-1, 3)
    p_SM = p_SM[np.isfinite(p_SM).all(axis=1)]
    frame = design.frame
    layout = design.markers
    rim = _rim_points(frame, layout.columns + 1, layout.rows + 1)
    heights = LinearNDInterpolator(
        np.concatenate([p_SM[:, :2], rim]), np.append(p_SM[:, 2], np.zeros(len(rim)))
    )
    coarse_x = np.linspace(-frame.length / 2, frame.length / 2, 2 * layout.columns + 3)
    coarse_y = np.linspace(-frame.width / 2, frame.width / 2, 2 * layout.rows + 3)
    z = np.nan_to_num(heights(*np.meshgrid(coarse_x, coarse_y)))
    z[[0, -1]] = 0.0
    z[:, [0, -1]] = 0.0
    spline = RectBivariateSpline(coarse_y, coarse_x, z)
    along_x = Cubic(frame.length, 2 * layout.columns + 2, GAUSS)
    along_y = Cubic(frame.width, 2 * layout.rows + 2, GAUSS)
    points = (along_y.points, along_x.points)
    stretch = np.sqrt(1 + spline(*points, dy=1) ** 2 + spline(*points, dx=1) ** 2)
    area = float(along_y.weights @ stretch @ along_x.weights)
    volume = float(along_y.weights @ spline(*points) @ along_x.weights)
    x, y = grid_of(frame)
    status = check_markers(len(p_SM), DEFAULTS.surface.markers_min)
    return Surface(x, y, spline(y, x), area, volume, np.nan, np.nan, status)


def _rim_points(frame: Frame, nx: int, ny: int) -> Array:
    """Return points (M, 2) all round the opening, nx and ny to a side."""
    t = np.linspace(-1, 1, nx, endpoint=False)
    s = np.linspace(-1, 1, ny, endpoint=False)
    right = np.column_stack([np.ones(ny), s])
    bottom = np.column_stack([t, -np.ones(nx)])
    square = np.concatenate([bottom, right, -bottom, -right])
    return square * [frame.length / 2, frame.width / 2]
