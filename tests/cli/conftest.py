"""Fixtures that run the command line in a separate folder.

It runs as a process or, far faster, as the function that the process calls.
"""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from mjtactile.cli import main

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


@pytest.fixture
def command(tmp_path: Path, monkeypatch, capfd) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run `mjtactile ARGS` in this process and an empty folder. Return the exit code, stdout and
    stderr, including output of libraries."""
    monkeypatch.chdir(tmp_path)

    def call(*args: object) -> subprocess.CompletedProcess[str]:
        argv = [str(argument) for argument in args]
        capfd.readouterr()
        try:
            code = main(argv)
        except SystemExit as end:  # --help, --version
            code = end.code
        return subprocess.CompletedProcess(argv, code, *capfd.readouterr())

    return call
