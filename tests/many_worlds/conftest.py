"""Scenes of MuJoCo Warp on a CPU."""

import importlib
import pkgutil
from pathlib import Path

import pytest

from benchmarks.gpu.linear_solver import stop_at_convergence

FOLDER = Path(__file__).parent


def pytest_collection_modifyitems(items):
    """Run all tests here in one worker: each worker would compile the same kernels for a minute."""
    for item in items:
        if item.path.is_relative_to(FOLDER):
            item.add_marker(pytest.mark.xdist_group("Warp"))


@pytest.fixture(autouse=True, scope="session")
def quick_compilation():
    """Compile MuJoCo Warp without optimization, and membranes without Warp's increased inlining.

    Compiling takes more time than the two or three worlds of these tests.
    """
    wp = pytest.importorskip("warp")
    device = importlib.import_module("mjtactile.warp.device")
    wp.config.optimization_level = 0
    wp.config.cpu_compiler_flags = "-march=native"
    for part in pkgutil.iter_modules(device.__path__, f"{device.__name__}."):
        module = importlib.import_module(part.name)
        wp.set_module_options({"optimization_level": 2}, module=module)


@pytest.fixture(autouse=True, scope="module")
def linear_solver_stops_at_convergence():
    with stop_at_convergence():
        yield
