"""Location of the shipped sensors, objects, grippers and controllers.

They are next to the package in a checkout, and inside it in a wheel.
"""

from __future__ import annotations

from pathlib import Path

from mjtactile.core import foreign_file
from mjtactile.core.errors import InputError

_PACKAGE = Path(__file__).resolve().parents[1]


def folder(name: str) -> Path:
    """Return the shipped folder `name`, such as "models/sensors" or "controllers"."""
    for root in (_PACKAGE, _PACKAGE.parent):
        if foreign_file.is_dir(root / name):
            return root / name
    raise InputError(
        "the installation is incomplete: folder not found", source=_PACKAGE, field=name
    )


def names(kind: str, suffix: str) -> list[str]:
    """Return the names that a user may give for files shipped in folder `kind`."""
    # not by `glob`, whose open folder would be reported where a signal interrupts it
    return sorted(path.stem for path in folder(kind).iterdir() if path.name.endswith(suffix))


def find(name_or_path: str | Path, kind: str, suffix: str) -> Path:
    """Resolve a shipped name or a user's path to a file.

    Raises InputError that lists the shipped names if the file does not exist.
    """
    text = str(name_or_path)
    item = kind.rsplit("/", 1)[-1].rstrip("s")
    choices = [*names(kind, suffix), f"FILE{suffix}"]
    if text.endswith(suffix) or "/" in text:
        path = foreign_file.user_path(text)
        if not text.endswith(suffix):
            raise InputError(f"does not end in {suffix}", source=text, field=item, choices=choices)
        if foreign_file.is_file(path):
            return path
        raise InputError("no such file", source=text, field=item, choices=choices)
    path = folder(kind) / f"{text}{suffix}"
    if foreign_file.is_file(path):
        return path
    raise InputError(f"unknown {item}", source=text, choices=choices)
