"""Reader of MJCF files from any source."""

from __future__ import annotations

import contextlib
import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco

from mjtactile.core.errors import InputError

LARGEST = 32 << 20  # bytes
MOST = 20_000
"""Maximum number of copies of elements in a file."""
_COPIES = ("replicate", "composite", "flexcomp")


def read_mjcf(path: Path, text: str = "", field: str | None = None) -> mujoco.MjSpec:
    """Return the specification of the file, or of `text` if it is not empty.

    Raises InputError that names `field` for invalid MJCF or too many elements.
    """
    try:
        if not text and path.stat().st_size > LARGEST:
            raise InputError(
                f"is larger than {LARGEST >> 20} MiB, the limit for an MJCF file",
                source=path,
                field=field,
            )
        _check_copies(path, text or path.read_text(encoding="utf-8-sig", errors="replace"), field)
        if text:
            return mujoco.MjSpec.from_string(text)
        return mujoco.MjSpec.from_file(str(path))
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=path, field=field) from error
    except (ValueError, RuntimeError) as error:
        raise InputError(
            f"not valid MJCF: {' '.join(str(error).split())}", source=path, field=field
        ) from error


def _check_copies(path: Path, text: str, field: str | None) -> None:
    with contextlib.suppress(ElementTree.ParseError):  # which MuJoCo reports better
        waiting = [(ElementTree.fromstring(text), 1)]
        while waiting:
            element, copies = waiting.pop()
            if element.tag in _COPIES:
                copies *= _count(element.get("count", "1"))
                if copies > MOST:
                    raise InputError(
                        f"makes {copies} copies; at most {MOST} are allowed",
                        source=path,
                        field=field or element.tag,
                    )
            waiting += [(child, copies) for child in element]


def _count(text: str) -> int:
    """Return the product of the integers in the text; 1 if it does not consist of integers."""
    try:
        return math.prod(max(int(word), 1) for word in text.split())
    except ValueError:
        return 1
