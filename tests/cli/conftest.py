"""The command line as a user meets it: a process with a folder of its own."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]


@pytest.fixture
def mjtactile(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run `mjtactile ARGS` in an empty folder and return the finished process."""

    def call(*args: object, timeout: float = 900) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-W", "error", "-m", "mjtactile", *map(str, args)]
        return subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, timeout=timeout, check=False
        )

    return call
