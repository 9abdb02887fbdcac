"""Linear solver of MuJoCo Warp's discrete integrator on a CPU."""

from __future__ import annotations

import contextlib
import inspect
import sys
import types
from collections.abc import Iterator
from typing import Any
from unittest import mock


class _Warp:
    """Module warp that reports a GPU."""

    def __getattr__(self, name: str) -> Any:
        import warp

        return getattr(warp, name)

    def get_device(self) -> Any:
        return types.SimpleNamespace(is_cuda=True)


@contextlib.contextmanager
def stop_at_convergence() -> Iterator[None]:
    """Stop the linear solver at convergence.

    Without a GPU it always runs all iterations. Iterations after convergence change no value. They
    take 85 % of the time.
    """
    derivative = sys.modules.get("mujoco_warp._src.derivative")
    if derivative is None:  # a process that does not use it
        yield
        return
    solve = inspect.unwrap(derivative.eff_solve)
    namespace = {**vars(derivative), "wp": _Warp()}
    copy = types.FunctionType(solve.__code__, namespace, argdefs=solve.__defaults__)
    with mock.patch.object(derivative, "eff_solve", copy):
        yield
