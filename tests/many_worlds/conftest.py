"""Scenes of MuJoCo Warp on a CPU."""

import inspect
import types

import pytest


class _Warp:
    """The module warp, for a function that asks for a GPU in order to stop at convergence."""

    def __getattr__(self, name):
        import warp

        return getattr(warp, name)

    def get_device(self):
        return types.SimpleNamespace(is_cuda=True)


@pytest.fixture(autouse=True)
def linear_solver_stops_at_convergence(monkeypatch):
    """Stop the linear solver of MuJoCo Warp's discrete integrator at convergence.

    It does so on a GPU only. On a CPU the remaining ones of its 300 iterations change no value and
    take six sevenths of a step.
    """
    derivative = pytest.importorskip("mujoco_warp._src.derivative")
    solve = inspect.unwrap(derivative.eff_solve)
    namespace = {**vars(derivative), "wp": _Warp()}
    copy = types.FunctionType(solve.__code__, namespace, argdefs=solve.__defaults__)
    monkeypatch.setattr(derivative, "eff_solve", copy)
