"""Time-critical code in C: loops over markers, pixels and splines.

The kernels need neither numpy's temporary arrays nor Python's lock. The packages that use a kernel
document its computation and contain its Python interface. This package holds the C sources (`*.c`,
declared in `kernels.h`), their build (`build`) and their loading (`kernel`, `bound`). See
docs/decisions/0015-compiled-pipeline.md.
"""

from mjtactile.kernels.bindings import band_stride, bound, kernel, words

__all__ = ["band_stride", "bound", "kernel", "words"]
