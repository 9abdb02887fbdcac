"""Access to the folder `benchmarks`, which exists in a checkout but not in an installed package."""

from __future__ import annotations

import importlib
from types import ModuleType

from mjtactile import InputError


def of_checkout(module: str) -> ModuleType:
    """Import the module of this name from the folder `benchmarks`.

    Raises:
        InputError: this is an installed package, which has no benchmarks.
    """
    try:
        return importlib.import_module(f"benchmarks.{module}")
    except ModuleNotFoundError as error:
        if error.name is None or not f"benchmarks.{module}".startswith(error.name):
            raise
    raise InputError(
        "benchmarks are not in the installed package; run them from a checkout of the "
        "project's source, folder 'benchmarks' (pip install --editable .)"
    )
