"""Red-black relaxation of a membrane's heights and in-plane displacements, as native snippets.

On CUDA one block of threads relaxes one membrane in shared memory. On the CPU a block is one thread
and the arrays are on the stack.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

MAX_NODES = 1344
"""Maximum number of nodes of a grid: nine fields of it fit the shared memory of a block."""

_SYNC = """
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
"""

_STORAGE = """
#if defined(__CUDA_ARCH__)
    __shared__ float %(fields)s;
    const int threads = blockDim.x;
#else
    float %(fields)s;
    const int threads = 1;
#endif
    const int N = nx * ny, half = (N + 1) / 2;
    const long F = (long)f * N;
"""


def _storage(*names: str) -> str:
    return _STORAGE % {"fields": ", ".join(f"{name}[{MAX_NODES}]" for name in names)}


@wp.func_native(_SYNC)
def synchronize() -> None:
    """Wait for all threads of the block."""


# a pair of neighboring nodes has one of each color
_EACH_OF_A_COLOR = """
    for (int s = 0; s < sweeps; s++) for (int color = 0; color < 2; color++) {
        for (int q = lane; q < half; q += threads) {
            const int i = (2 * q) / ny;
            int j = 2 * q - i * ny;
            j += ((i + j) & 1) ^ color;
            const int k = i * ny + j;
            if (k >= N || j >= ny || free.data[k] <= 0) continue;
"""

_HEIGHTS = (
    _storage("z", "top", "lx", "ly", "r")
    + """
    for (int k = lane; k < N; k += threads) {
        z[k] = change.data[F + k], top[k] = gap.data[F + k];
        lx[k] = link_x.data[F + k], ly[k] = link_y.data[F + k];
        r[k] = residual.data[F + k] + dp * swell.data[F + k];
    }
"""
    + _SYNC
    + _EACH_OF_A_COLOR
    + """
            const float d = lx[k - ny] + lx[k] + ly[k - 1] + ly[k];
            const float g = (lx[k - ny] * z[k - ny] + lx[k] * z[k + ny] + ly[k - 1] * z[k - 1]
                             + ly[k] * z[k + 1] + r[k]) / d;
            const float v = z[k] + relaxation * (g - z[k]);
            z[k] = v < top[k] ? v : top[k];
        }
"""
    + _SYNC
    + """
    }
    for (int k = lane; k < N; k += threads) {
        float q = 0.f;
        if (free.data[k] > 0 && z[k] >= top[k] - 1e-9f) {
            const float d = lx[k - ny] + lx[k] + ly[k - 1] + ly[k];
            q = lx[k - ny] * z[k - ny] + lx[k] * z[k + ny] + ly[k - 1] * z[k - 1] + ly[k] * z[k + 1]
                + r[k] - d * z[k];
            q = q > 0.f ? q : 0.f;
        }
        force.data[F + k] = q, change.data[F + k] = z[k];
    }
"""
    + _SYNC
)

_PLANE = (
    _storage("u", "v", "a", "b", "e")
    + """
    for (int k = lane; k < N; k += threads) {
        u[k] = 0.f, v[k] = 0.f, e[k] = extra.data[F + k];
        a[k] = rx.data[F + k], b[k] = ry.data[F + k];
    }
"""
    + _SYNC
    + "const float *st = stencil.data;  /* xx: own, +-x, +-y, diagonal; yy: the same; xy */\n"
    + _EACH_OF_A_COLOR
    + """
            const int pp = k + ny + 1, pm = k + ny - 1, mp = k - ny + 1, mm = k - ny - 1;
            const float cu = u[pp] - u[pm] - u[mp] + u[mm], cv = v[pp] - v[pm] - v[mp] + v[mm];
            const float su = u[pp] + u[pm] + u[mp] + u[mm], sv = v[pp] + v[pm] + v[mp] + v[mm];
            const float gu = (a[k] - scale * (st[1] * (u[k + ny] + u[k - ny])
                              + st[2] * (u[k + 1] + u[k - 1]) + st[3] * su + st[8] * cv))
                             / (scale * st[0] + e[k]);
            const float gv = (b[k] - scale * (st[5] * (v[k + ny] + v[k - ny])
                              + st[6] * (v[k + 1] + v[k - 1]) + st[7] * sv + st[8] * cu))
                             / (scale * st[4] + e[k]);
            u[k] += relaxation * (gu - u[k]), v[k] += relaxation * (gv - v[k]);
        }
"""
    + _SYNC
    + """
    }
    for (int k = lane; k < N; k += threads) { rx.data[F + k] = u[k], ry.data[F + k] = v[k]; }
"""
    + _SYNC
)


@wp.func_native(_HEIGHTS)
def relax_heights(
    f: int,
    lane: int,
    nx: int,
    ny: int,
    relaxation: float,
    sweeps: int,
    dp: float,
    free: wp.array(dtype=int),
    change: wp.array2d(dtype=float),
    gap: wp.array2d(dtype=float),
    swell: wp.array2d(dtype=float),
    link_x: wp.array2d(dtype=float),
    link_y: wp.array2d(dtype=float),
    residual: wp.array2d(dtype=float),
    force: wp.array2d(dtype=float),
) -> None:
    """Continue the `change` of heights, m, at a further gas pressure `dp`, Pa; write `force`.

    `gap` is the space below the obstacles, `swell` the derivative of the volume by the heights.
    """


@wp.func_native(_PLANE)
def relax_plane(
    f: int,
    lane: int,
    nx: int,
    ny: int,
    relaxation: float,
    sweeps: int,
    scale: float,
    free: wp.array(dtype=int),
    stencil: wp.array(dtype=float),
    extra: wp.array2d(dtype=float),
    rx: wp.array2d(dtype=float),
    ry: wp.array2d(dtype=float),
) -> None:
    """Replace the residual `rx`, `ry` by the change of the in-plane displacements."""
