"""What the commands share: a checked output folder, a stdout that stays clean, JSON."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mjtactile.errors import InputError
from mjtactile.recording import to_json


def prepare_folder(path: Path) -> Path:
    """Make the output folder and prove that it can be written, before any work is done. Raises InputError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path, prefix=".writable-"):
            pass
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", source=path, field="--out") from error
    return path


@contextlib.contextmanager
def stdout_to_stderr() -> Iterator[None]:
    """Send everything written to stdout, by Python or by a C library, to stderr meanwhile."""
    sys.stdout.flush()
    saved = os.dup(1)
    os.dup2(2, 1)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        sys.stderr.flush()
        os.dup2(saved, 1)
        os.close(saved)


def print_json(value: Any) -> None:
    """Print one JSON object to stdout; non-finite numbers are null."""
    print(json.dumps(to_json(value), indent=2, allow_nan=False))
