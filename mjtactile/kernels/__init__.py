"""What costs time, in C: loops over markers, pixels and splines that need neither numpy's
temporaries nor Python's lock.

The rooms that use a kernel say what it computes and hold its Python face; here are the C sources
(`*.c`, declared in `kernels.h`), their build (`build`) and their loading (`kernel`, `bound`). See
docs/decisions/0015-compiled-chain.md.
"""

from mjtactile.kernels.bindings import band_stride, bound, kernel, words

__all__ = ["band_stride", "bound", "kernel", "words"]
