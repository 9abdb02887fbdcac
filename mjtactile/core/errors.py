"""One exception tree. Every error carries the process exit code that the command line reports for
it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

_LONGEST = 1200  # characters of a message


class MjtactileError(Exception):
    """Base of all errors that this package raises on purpose.

    Its text is one line for the user.
    """

    exit_code = 3

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the state for pickling between processes. Constructor arguments differ from the
        message."""
        return _rebuild, (type(self), self.args, self.__dict__)


def _rebuild(
    kind: type[MjtactileError], args: tuple[Any, ...], state: dict[str, Any]
) -> MjtactileError:
    error = kind.__new__(kind, *args)
    error.__dict__.update(state)
    return error


class InputError(MjtactileError):
    """Bad configuration or arguments.

    The message is one line that names the file or argument, the field, and the valid choices; exit
    code 2.

    Attributes:
        source: The file or argument.
        field: The field in it.
    """

    exit_code = 2

    def __init__(
        self,
        message: str,
        *,
        source: object = None,
        field: str | None = None,
        choices: Iterable[object] | None = None,
    ):
        self.source = source
        self.field = field
        self._stated = message, None if choices is None else tuple(map(str, choices))
        where = ": ".join(str(part) for part in (source, field) if part is not None)
        text = f"{where}: {message}" if where else message
        if self._stated[1] is not None:
            text += f" (valid: {', '.join(self._stated[1])})"
        super().__init__(_shortened(text))

    def at(self, field: str, source: object = None) -> InputError:
        """Return the same error of the value at another place.

        Args:
            field: The field in the file, or the option.
            source: The file; None: an option.

        Returns:
            The error.
        """
        message, choices = self._stated
        return InputError(message, source=source, field=field, choices=choices)


def _shortened(text: str) -> str:
    """Return a message in one line. The central part of a very long value is omitted."""
    if "\n" in text:  # such as that of an array
        text = " ".join(text.split())
    if len(text) <= _LONGEST:
        return text
    return f"{text[: _LONGEST // 2]} … {text[-_LONGEST // 2 :]}"


class ControllerError(InputError):
    """Error of a user's controller: an exception, no return value, or a value that cannot be
    executed.

    Attributes:
        kind: "raised", or "hung" if a step did not return.
    """

    def __init__(self, message: str, *, kind: str = "raised", **where: Any):
        self.kind = kind
        super().__init__(message, **where)


class Interrupted(MjtactileError):
    """A signal requested the end of the run, which then ended in order."""

    def __init__(self) -> None:
        super().__init__("interrupted")


class DeviceError(MjtactileError):
    """A device is missing, stale or faulted; exit code 3."""


class SafeStop(DeviceError):
    """Error after the gripper was brought to its safe state instead of continuing.

    Attributes:
        kind: "unsafe", or "hung" if the run did not end in its time.
    """

    def __init__(self, message: str, *, kind: str = "unsafe"):
        self.kind = kind
        super().__init__(message)


class SimulationError(MjtactileError):
    """The simulation diverged, or left its valid range; exit code 3.

    Attributes:
        reason: Cause of the failure.
        step: Number of the failed step.
        time: Simulated time, s.
    """

    def __init__(self, reason: str, *, step: int, time: float):
        self.reason = reason
        self.step = step
        self.time = time
        super().__init__(f"simulation failed at step {step} (t = {time:.4f} s): {reason}")
