"""Scenes of MuJoCo Warp on a CPU."""

import inspect
import sys
import types
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent


def pytest_collection_modifyitems(items):
    """Run all tests here in one worker: each worker would compile the same kernels for a minute."""
    for item in items:
        if item.path.is_relative_to(FOLDER):
            item.add_marker(pytest.mark.xdist_group("Warp"))


class _Warp:
    """Module warp that reports a GPU."""

    def __getattr__(self, name):
        import warp

        return getattr(warp, name)

    def get_device(self):
        return types.SimpleNamespace(is_cuda=True)


@pytest.fixture(autouse=True, scope="module")
def linear_solver_stops_at_convergence():
    """Stop the linear solver of MuJoCo Warp's discrete integrator at convergence.

    Without a GPU it runs all 300 iterations. Iterations after convergence change no value. They
    take 85 % of the time.
    """
    derivative = sys.modules.get("mujoco_warp._src.derivative")
    if derivative is None:  # a module that does not use it
        yield
        return
    solve = inspect.unwrap(derivative.eff_solve)
    namespace = {**vars(derivative), "wp": _Warp()}
    copy = types.FunctionType(solve.__code__, namespace, argdefs=solve.__defaults__)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(derivative, "eff_solve", copy)
        yield
