"""Load a user's controller and guard the calls to it."""

from __future__ import annotations

import importlib.util
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mjtactile import resources
from mjtactile.errors import ControllerError, InputError
from mjtactile.types import Command, Observation


@dataclass(frozen=True)
class Controller:
    """A controller file and its `step` function; calling it checks what comes back."""

    path: Path
    function: Callable[[Observation], Any]

    def step(self, observation: Observation) -> Command:
        """Run the user's `step`.

        Raises ControllerError naming the file and the line when it raises, and the field when it returns nothing or
        something that is not a Command (a Command checks its own numbers).
        """
        try:
            command = self.function(observation)
        except Exception as error:
            line = next((f.lineno for f in reversed(traceback.extract_tb(error.__traceback__))
                         if Path(f.filename).resolve() == self.path.resolve()), None)
            where = f"line {line}" if line else None
            raise ControllerError(f"step() raised {type(error).__name__}: {error} at t = {observation.time:.3f} s",
                                  source=self.path, field=where) from error
        if not isinstance(command, Command):
            raise ControllerError(f"step() returned {command!r} at t = {observation.time:.3f} s, not a Command",
                                  source=self.path, field="step")
        return command


def load_controller(name_or_path: str | Path) -> Controller:
    """Load a controller by shipped name or from a user's file.

    Raises InputError for a missing file, ControllerError for one that does not import or has no `step`.
    """
    path = resources.find(name_or_path, "controllers", ".py")
    spec = importlib.util.spec_from_file_location(f"mjtactile_controller_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError("not a Python file", source=path, field="controller")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        line = getattr(error, "lineno", None)
        where = f"line {line}" if line else None
        raise ControllerError(f"does not import: {type(error).__name__}: {error}", source=path, field=where) from error
    function = getattr(module, "step", None)
    if not callable(function):
        raise ControllerError("has no function step(observation) -> command", source=path, field="step")
    return Controller(path, function)
