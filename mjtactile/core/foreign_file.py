"""Files from anywhere: read with limits, and with errors of one line."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from mjtactile.core.errors import InputError


def read_text(path: Path, largest: int, content: str) -> str:
    """Read a UTF-8 file as `read_bytes` does. A byte order mark is ignored.

    Raises UnicodeDecodeError if it is not UTF-8.
    """
    return read_bytes(path, largest, content).decode("utf-8-sig")


def read_bytes(path: Path, largest: int, content: str, field: str | None = None) -> bytes:
    """Read a file of at most `largest` bytes.

    Args:
        path: The file.
        largest: Maximum size, bytes.
        content: Kind of the file in the message, such as "an image".
        field: Field or option that names the file.

    Returns:
        The content.

    Raises:
        InputError: The file is missing, larger, or not a file: a pipe or a device may never end.
    """
    try:
        # without O_NONBLOCK, opening a pipe waits for its writer
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as file:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise InputError("is not a regular file", source=path, field=field)
            data = file.read(largest + 1)
    except (OSError, ValueError) as error:  # ValueError: a null character
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot be read: {reason}", source=path, field=field) from error
    if len(data) > largest:
        message = f"is larger than {_size_text(largest)}, the limit for {content}"
        raise InputError(message, source=path, field=field)
    return data


def user_path(text: str | Path) -> Path:
    """Return the path of a user's text, with "~" expanded. An unknown user's "~" is kept."""
    try:
        return Path(text).expanduser()
    except RuntimeError:
        return Path(text)


def is_file(path: Path) -> bool:
    """Return True if the path is a file; False also for a name that no file can have.

    `Path.is_file` raises an error for a name of more than 255 bytes.
    """
    return stat.S_ISREG(_mode(path))


def is_dir(path: Path) -> bool:
    """Return True if the path is a folder; False also for a name that no folder can have."""
    return stat.S_ISDIR(_mode(path))


def exists(path: Path) -> bool:
    """Return True if there is a file or folder; False also for a name that none can have."""
    return _mode(path) != 0


def _mode(path: Path) -> int:
    """Return type and permissions of a file or folder; 0 if there is none."""
    try:
        return path.stat().st_mode
    except (OSError, ValueError):  # ValueError: a null character
        return 0


def _size_text(size: int) -> str:
    """Return a size in bytes with its unit."""
    for bits, unit in ((20, "MiB"), (10, "KiB")):
        if size >= 1 << bits:
            return f"{size >> bits} {unit}"
    return f"{size} bytes"
