"""Scenes of MuJoCo Warp on a CPU."""

from pathlib import Path

import pytest

from benchmarks.gpu.linear_solver import stop_at_convergence

FOLDER = Path(__file__).parent


def pytest_collection_modifyitems(items):
    """Run all tests here in one worker: each worker would compile the same kernels for a minute."""
    for item in items:
        if item.path.is_relative_to(FOLDER):
            item.add_marker(pytest.mark.xdist_group("Warp"))


@pytest.fixture(autouse=True, scope="module")
def linear_solver_stops_at_convergence():
    with stop_at_convergence():
        yield
