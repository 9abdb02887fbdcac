"""Files of an evaluation: `manifest.json` with settings, `episodes.jsonl` with lines of episodes.

A line is written when its episode ends, and the file is sorted at the end. An interruption loses
only the episodes in progress.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import json
import logging
import platform
import shlex
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from mjtactile.core import foreign_file
from mjtactile.core.errors import DeviceError, InputError
from mjtactile.core.toml import read_json

MANIFEST = "manifest.json"
EPISODES = "episodes.jsonl"
DAMAGED = ".damaged"
"""Suffix of the copy of `EPISODES` with lines that are left out."""
RESULTS = (EPISODES, "summary.json", "summary.md", "report.html", "recordings", "worst")
"""Other results in the folder of an evaluation."""
_SCENARIO = ("task", "sensor", "rig", "effects", "accuracy", "randomization")
_logger = logging.getLogger(__name__)
_LARGEST = 1 << 30  # maximum size of the episodes, bytes
_NAMED = 5  # differing fields or damaged lines in a message
_DIGITS = 12  # characters of a checksum in a message
_PACKAGES = ("mjtactile", "mujoco", "numpy", "scipy", "opencv-contrib-python-headless")


def manifest(options: Mapping[str, Any], files: Iterable[Path]) -> dict[str, Any]:
    """Return the command, and what the lines depend on: options, versions, SHA-256 of files."""
    paths = list(files)
    count = Counter(path.name for path in paths)
    keys = {path: path.name if count[path.name] == 1 else str(path) for path in paths}
    return {
        "command": command(options),
        "options": dict(options),
        "python": platform.python_version(),
        "versions": {name: importlib.metadata.version(name) for name in _PACKAGES},
        "files": {keys[path]: checksum(path) for path in paths},
    }


def checksum(path: Path) -> str:
    """Return the SHA-256 of a file; of a TOML file its values, so that comments do not count."""
    content = path.read_bytes()
    if path.suffix == ".toml":
        content = json.dumps(tomllib.loads(content.decode()), sort_keys=True).encode()
    return hashlib.sha256(content).hexdigest()


def command(options: Mapping[str, Any]) -> str:
    """Return the command line for `options`."""
    part, parts = options["shard"]
    scenario = options["scenario"]
    words = [
        "mjtactile",
        "evaluate",
        *(f"--controller={name}" for name in options["controllers"]),
        f"--objects={','.join(options['objects'])}",
        f"--episodes={options['count']}",
        f"--seed={scenario['seed']}",
        *(f"--{name}={scenario[name]}" for name in _SCENARIO if scenario.get(name)),
        *(["--contact-shapes"] if scenario.get("contact_shapes") else []),
        *([f"--shard={part}/{parts}"] if parts > 1 else []),
    ]
    return shlex.join(words)


class Store:
    """Folder of one evaluation, opened for appending; with `resume`, it may hold its first part.

    Raises InputError if it holds another evaluation, one without `resume`, or unknown results.
    """

    def __init__(self, folder: Path, evaluation: Mapping[str, Any], *, resume: bool):
        self.folder = folder
        self.lines = []
        known = folder / MANIFEST
        if foreign_file.exists(known) and not resume:
            message = "already holds an evaluation; --resume continues it"
            raise InputError(message, source=folder, field="--out")
        if foreign_file.exists(known):
            _require_same(known, evaluation)
            self.lines = read_lines(folder)
            _keep_damaged(folder / EPISODES, self.lines)
        else:
            _refuse_unknown_files(folder)
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            known.write_text(json.dumps(evaluation, indent=1) + "\n", encoding="utf-8")
        self._rewrite()  # without a line that was cut off

    def add(self, line: dict[str, Any]) -> None:
        """Append a line. Raises DeviceError if it cannot be written."""
        path = self.folder / EPISODES
        with writing(path), path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        self.lines.append(line)

    def finish(self) -> None:
        """Sort the lines."""
        self.lines.sort(key=lambda line: (line["episode"], line["controller"]))
        self._rewrite()

    def _rewrite(self) -> None:
        write_lines(self.folder, self.lines)


def _keep_damaged(path: Path, lines: Sequence[Mapping[str, Any]]) -> None:
    """Keep a copy of a file with damaged lines, since it is written again without them."""
    text = path.read_bytes()
    if text.count(b"\n") > len(lines):
        with writing(path):
            path.with_name(path.name + DAMAGED).write_bytes(text)


def write_lines(folder: Path, lines: Sequence[Mapping[str, Any]]) -> None:
    """Write all lines, or none."""
    part = folder / (EPISODES + ".part")
    with writing(folder / EPISODES):
        part.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
        part.replace(folder / EPISODES)


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Convert a failed write to DeviceError."""
    try:
        yield
    except OSError as error:
        raise DeviceError(
            f"{path}: cannot be written: {error.strerror}; the completed episodes are kept, "
            "--resume continues"
        ) from error


def read_lines(folder: Path) -> list[dict[str, Any]]:
    """Read the complete lines of an evaluation; damaged ones are left out with a warning.

    Raises InputError if there are none.
    """
    lines, damaged = _read_lines(folder / EPISODES)
    if damaged:
        _logger.warning(
            "%s: %d damaged lines are left out: %s",
            folder / EPISODES,
            len(damaged),
            ", ".join(f"line {number}" for number in damaged[:_NAMED])
            + (", ..." if len(damaged) > _NAMED else ""),
        )
    return lines


def _read_lines(path: Path) -> tuple[list[dict[str, Any]], list[int]]:
    """Return the complete lines, and the numbers of the damaged ones, from 1."""
    data = foreign_file.read_bytes(path, _LARGEST, "the episodes of an evaluation")
    text = data.decode("utf-8", errors="replace")
    complete = text.splitlines() if text.endswith("\n") else text.splitlines()[:-1]
    found = [_line(line) for line in complete]
    lines = [line for line in found if line is not None]
    return lines, [number for number, line in enumerate(found, 1) if line is None]


def _line(text: str) -> dict[str, Any] | None:
    """Parse one line; None for a damaged line."""
    try:
        line = json.loads(text)
        return line if {"episode", "controller", "outcome"} <= line.keys() else None
    except (ValueError, AttributeError, RecursionError):
        return None


def _refuse_unknown_files(folder: Path) -> None:
    for name in RESULTS:
        if foreign_file.exists(folder / name):
            action = "it is kept: choose another folder"
            message = f"holds {name} without the {MANIFEST} that describes it; {action}"
            raise InputError(message, source=folder, field="--out")


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read the manifest of an evaluation. Raises InputError if `folder` does not contain one."""
    try:
        found = read_json(folder / MANIFEST)
    except InputError as error:
        raise InputError(f"no evaluation: {error}", source=folder) from error
    if not isinstance(found, dict) or not isinstance(found.get("options"), dict):
        raise InputError("no evaluation", source=folder / MANIFEST, field="options")
    return found


def _require_same(path: Path, evaluation: Mapping[str, Any]) -> None:
    before = read_manifest(path.parent)
    now = json.loads(json.dumps(evaluation))
    old_count, count = (each.get("options", {}).get("count", 0) for each in (before, now))
    if old_count < count:  # more of the same
        before["options"]["count"] = count
    for part in (name for name in now if name != "command"):  # the options contain its parts
        if differing := differences(before.get(part), now[part]):
            message = f"was started with different {part}: {differing}"
            raise InputError(message, source=path, field="--resume")


def differences(before: Any, now: Any) -> str:
    """Name the fields that differ between two tables of JSON values, each with both values; "" if
    there are none."""
    found = list(_differing(before, now, ""))
    more = ", ..." if len(found) > _NAMED else ""
    return ", ".join(found[:_NAMED]) + more


def _differing(before: Any, now: Any, name: str) -> Iterator[str]:
    if before == now:
        return
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        for key in dict.fromkeys((*before, *now)):
            yield from _differing(before.get(key), now.get(key), f"{name}.{key}" if name else key)
    else:
        yield f"{name} {_shortened(before)}, now {_shortened(now)}".strip()


def _shortened(value: Any) -> str:
    if value is None:
        return "none"
    text = value if isinstance(value, str) else json.dumps(value)
    is_checksum = (
        isinstance(value, str) and len(value) == 64 and not set(value) - set("0123456789abcdef")
    )
    return f"{text[:_DIGITS]}..." if is_checksum else text
