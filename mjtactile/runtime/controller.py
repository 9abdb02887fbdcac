"""Load a user's controller and guard the calls to it."""

from __future__ import annotations

import contextlib
import ctypes
import importlib.machinery
import importlib.util
import queue
import sys
import threading
import traceback
import types
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from mjtactile.core import resources, scaled_clock
from mjtactile.core.errors import ControllerError, InputError
from mjtactile.core.signature_checks import validated
from mjtactile.core.types import Command, Observation

# Minimum timeout of the first step, s: it may import modules, and no object is grasped yet
_FIRST_TIME = 3.0
_EXTRA_TIME = 0.02


class LoadedController(Protocol):
    """Controller for the loop; `path` is for messages."""

    @property
    def path(self) -> Path: ...

    def step(self, observation: Observation) -> Command: ...


READABLE = ("contact_shape",)
"""Parts of a touch that are computed only if `REQUIRES` of the controller lists them, for speed."""


@dataclass(frozen=True)
class Controller:
    """A controller file and its `step` function. A call checks the returned command.

    `reads` are the entries of READABLE that it needs.
    """

    path: Path
    function: Callable[[Observation], Any]
    reads: tuple[str, ...] = ()

    def step(self, observation: Observation) -> Command:
        """Run the user's `step`.

        Raises ControllerError. It names the file and the line if `step` raises an exception. It
        names the field if `step` returns no Command. A Command checks its own values.
        """
        try:
            command = self.function(observation)
        except BaseException as error:
            in_main_thread = threading.current_thread() is threading.main_thread()
            if isinstance(error, KeyboardInterrupt) and in_main_thread:
                raise  # Ctrl-C; in another thread the controller itself raised it
            if isinstance(error, MemoryError):
                traceback.clear_frames(error.__traceback__)  # free the memory of its frames
            raise ControllerError(
                f"step() raised {type(error).__name__}: {error} at t = {observation.time:.3f} s",
                source=self.path,
                field=_line(self.path, traceback.extract_tb(error.__traceback__)),
            ) from error
        if not isinstance(command, Command):
            message = f"step() returned {command!r} at t = {observation.time:.3f} s, not a Command"
            raise ControllerError(message, source=self.path, field="step")
        return command


class ControllerThread:
    """Thread for a controller, so that a step that does not return does not block the program.

    Use as a context manager. A step is given `limit` s of wall time. A switch to the thread and
    back takes about 0.03 ms.
    """

    def __init__(self, controller: LoadedController, limit: float):
        self.controller = controller
        self._limit = limit
        self._patience = max(limit, _FIRST_TIME)
        self._questions: queue.SimpleQueue[Observation | None] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[Command | BaseException] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="controller", daemon=True)

    def __enter__(self) -> ControllerThread:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._questions.put(None)

    def step(self, observation: Observation) -> Command:
        """Return the controller's command after checks of its values.

        Raises the controller's own error. Raises ControllerError on a timeout. The controller must
        not be called again then.
        """
        self._questions.put(observation)
        try:
            answer = self._answer()
        except queue.Empty:
            raise self._late(observation.time) from None
        self._patience = self._limit
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def _answer(self) -> Command | BaseException:
        """Return the controller's command or error. Raises queue.Empty after the time limit.

        If the whole process was suspended, the limit may expire before the controller could
        continue. So the call waits a second, short time.
        """
        with contextlib.suppress(queue.Empty):
            return self._answers.get(timeout=scaled_clock.wall(self._patience))
        return self._answers.get(timeout=scaled_clock.wall(_EXTRA_TIME))

    def _work(self) -> None:
        while (observation := self._questions.get()) is not None:
            try:
                self._answers.put(self.controller.step(observation).checked())
            except ControllerError as error:
                self._answers.put(error)
            except BaseException as error:  # noqa: BLE001  # a bad Command, or no controller file
                text = f"step() raised {type(error).__name__}: {error}"
                self._answers.put(ControllerError(text, source=self.controller.path, field="step"))

    def _late(self, time: float) -> ControllerError:
        """Return the error for a step that timed out, and request the thread to exit to save CPU
        time."""
        thread = self._thread.ident or 0
        path = self.controller.path
        frame = sys._current_frames().get(thread)
        line = _line(path, traceback.extract_stack(frame)) if frame is not None else None
        ctypes.pythonapi.PyThreadState_SetAsyncExc(
            ctypes.c_ulong(thread), ctypes.py_object(SystemExit)
        )
        message = f"step() did not return within {self._patience:g} s at t = {time:.3f} s"
        return ControllerError(message, source=path, field=line, kind="hung")


def _line(path: Path, stack: traceback.StackSummary) -> str | None:
    """Return the innermost line of the file `path` in a stack, as "line 7", or None."""
    with contextlib.suppress(OSError):  # a path that cannot be resolved any more
        for frame in reversed(stack):
            if Path(frame.filename).resolve() == path.resolve():
                return f"line {frame.lineno}"
    return None


class _UncachedLoader(importlib.machinery.SourceFileLoader):
    """Loader that compiles the current file and stores no bytecode.

    Python's bytecode cache compares only time and length, so it can miss an edit within one
    second.
    """

    def get_code(self, fullname: str) -> types.CodeType:
        return self.source_to_code(self.get_data(self.path), self.path)


@validated()
def load_controller(name_or_path: str | Path) -> Controller:
    """Load a controller.

    Args:
        name_or_path: A shipped name, or a user's Python file with a function `step(observation) ->
            command`.

    Returns:
        The controller; its `step` checks the returned command.

    Raises:
        InputError: The file does not exist.
        ControllerError: The file cannot be imported, or has no `step`.
    """
    path = resources.find(name_or_path, "controllers", ".py")
    path_hash = zlib.crc32(str(path.absolute()).encode())  # others of the same name have theirs
    name = f"mjtactile_controller_{path.stem}_{path_hash:08x}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise InputError("not a Python file", source=path, field="controller")
    if isinstance(spec.loader, importlib.machinery.SourceFileLoader):
        spec.loader = _UncachedLoader(name, str(path))
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses resolve the types of their fields here
    try:
        spec.loader.exec_module(module)
    except KeyboardInterrupt:
        raise  # Ctrl-C
    except BaseException as error:
        line = getattr(error, "lineno", None)
        where = f"line {line}" if line else None
        raise ControllerError(
            f"cannot be imported: {type(error).__name__}: {error}", source=path, field=where
        ) from error
    function = getattr(module, "step", None)
    if not callable(function):
        raise ControllerError(
            "has no function step(observation) -> command", source=path, field="step"
        )
    return Controller(path, function, _reads(module, path))


def _reads(module: types.ModuleType, path: Path) -> tuple[str, ...]:
    """Return the entries of REQUIRES in a controller's file. Raises ControllerError for an unknown
    one."""
    reads = getattr(module, "REQUIRES", ())
    listed = (reads,) if isinstance(reads, str) else tuple(reads)
    unknown = [name for name in listed if name not in READABLE]
    if unknown:
        message = f"{unknown[0]!r} cannot be required; choices: {', '.join(READABLE)}"
        raise ControllerError(message, source=path, field="REQUIRES")
    return listed
