"""Output shared by the commands: an output folder without overwriting, a clean stdout, JSON."""

from __future__ import annotations

import argparse
import contextlib
import datetime
import itertools
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mjtactile import InputError, Recording
from mjtactile.commands.nonblocking_output import Background
from mjtactile.core import foreign_file, resources, signals
from mjtactile.recording.files import to_json
from mjtactile.types import Flags


@contextlib.contextmanager
def output_folder(path: Path, *results: str) -> Iterator[Path]:
    """Create the output folder and check that it is writable, before any work.

    Raises InputError if it is not writable. It also raises InputError if one of `results` (files
    and folders to be written) exists. An empty folder is removed if the work fails.
    """
    taken = [name for name in results if foreign_file.exists(path / name)]
    if taken:
        message = f"the folder already contains {taken[0]}, and nothing is overwritten"
        raise InputError(f"{message}; choose another folder", source=path, field="--out")
    with _removed_if_empty(path):
        try:
            path.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile(dir=path, prefix=".writable-"):
                pass
        except OSError as error:
            message = f"the file cannot be written: {error.strerror}"
            raise InputError(message, source=path, field="--out") from error
        yield path


@contextlib.contextmanager
def complete_folder(path: Path, *results: str) -> Iterator[Path]:
    """Provide an empty folder whose contents are moved to `path` at the end: all, or none after a
    failure. Raises InputError as `output_folder`."""
    with (
        output_folder(path, *results) as out,
        tempfile.TemporaryDirectory(dir=out, prefix=".unfinished-") as part,
    ):
        yield Path(part)
        for item in sorted(Path(part).iterdir()):
            item.replace(out / item.name)


def require_new(path: Path, field: str = "--out") -> None:
    """Raise InputError if a file or folder of that name exists."""
    if foreign_file.exists(path):
        message = "the path exists already, and nothing is overwritten; choose another name"
        raise InputError(message, source=path, field=field)


@contextlib.contextmanager
def optional_folder(path: Path | None, *results: str) -> Iterator[Path | None]:
    """Create the output folder as `output_folder`; yield None without `--out`."""
    if path is None:
        yield None
        return
    with output_folder(path, *results):
        yield path


@contextlib.contextmanager
def new_run_folder(name: str) -> Iterator[Path]:
    """Create a new folder `runs/<time>-<name>`.

    A number is appended if another run of the same second has that name. Raises InputError if the
    folder cannot be created. An empty folder is removed if the work fails.
    """
    stem = Path("runs") / f"{datetime.datetime.now():%Y%m%d-%H%M%S}-{name}"
    for suffix in itertools.count(1):
        folder = stem if suffix == 1 else Path(f"{stem}-{suffix}")
        with _removed_if_empty(folder):
            try:
                folder.mkdir(parents=True)
            except FileExistsError:  # even if another process created it in the meantime
                continue
            except OSError as error:
                message = f"the file cannot be written: {error.strerror}"
                raise InputError(message, source=folder) from error
            yield folder
            return


@contextlib.contextmanager
def _removed_if_empty(path: Path) -> Iterator[None]:
    """Remove `path` and its parent folders on exit, if they are new and empty."""
    made = [folder for folder in (path, *path.parents) if not foreign_file.exists(folder)]
    try:
        yield
    finally:
        for folder in made:
            with contextlib.suppress(OSError):  # it is not empty
                folder.rmdir()


@contextlib.contextmanager
def stdout_to_stderr() -> Iterator[None]:
    """Redirect stdout of Python and C libraries to stderr inside the context.

    A background thread writes the output. A blocked terminal or a closed pipe therefore does not
    delay the run.
    """
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    with Background(2) as entry:
        saved = [os.dup(fd) for fd in (1, 2)]
        for fd in (1, 2):
            os.dup2(entry, fd)
        try:
            with contextlib.redirect_stdout(sys.stderr):
                yield
        finally:
            sys.stderr.flush()
            for fd, before in zip((1, 2), saved, strict=True):
                os.dup2(before, fd)
                os.close(before)


def print_json(value: Any) -> None:
    """Print one JSON object to stdout; non-finite numbers are null."""
    print(json.dumps(to_json(value), indent=2, allow_nan=False))


def print_result(
    options: argparse.Namespace, result: Any, text: str | Callable[[], object]
) -> None:
    """Print the result: with --json as one JSON object, otherwise as text, or by a function."""
    if options.json:
        print_json(result)
    elif isinstance(text, str):
        print(text)
    else:
        text()


def exit_code_of_steps(result: dict[str, Any], count: int) -> int:
    """Return the exit code of a result with "steps", of `count` requested ones. Print the reason
    under "stopped" to stderr."""
    if result["stopped"] is None:
        return 0
    complete = f"{len(result['steps'])} of {count} steps are complete"
    print(f"mjtactile: {result['stopped']}; {complete}", file=sys.stderr)
    return signals.EXIT_CODE


def save_plot(
    path: Path, plot: Callable[[Any], None], size: tuple[float, float] = (7.0, 4.6)
) -> None:
    """Plot with `plot` into a figure of `size` inches and write it. Without matplotlib, print a
    message to stderr."""
    from mjtactile.report.figures import new_figure

    if (figure := new_figure(path.name, size)) is not None:
        plot(figure)
        figure.savefig(path)


def print_flags(flags: Flags) -> None:
    """Print the reasons why a simulation's results are less accurate than usual."""
    for kind, flag in flags.items():
        print(f"  warning ({kind}): {flag}{f' ({flag.when})' if flag.when else ''}")


def print_problems(recording: Recording) -> None:
    """Print the parts of a recording that are damaged or missing."""
    for problem in recording.problems:
        print(f"  recording {problem}")


def page_of_table(name: str) -> Path:
    """Return the page of the documentation, or the README, that has the markers of `name`."""
    folder = resources.folder("docs")
    for page in (folder.parent / "README.md", *sorted(folder.rglob("*.md"))):
        if foreign_file.is_file(page) and _start_marker(name) in page.read_text(encoding="utf-8"):
            return page
    raise InputError(
        f"no page of the documentation has {_start_marker(name)}; give a file", field="--readme"
    )


def _start_marker(name: str) -> str:
    return f"<!-- bench:{name} -->"


def insert_table(path: Path, name: str, table: str) -> None:
    """Replace the text between the markers of `name` in a Markdown file. Raises InputError when
    they are missing."""
    head, start_marker, end, tail = _around_table(path, name)
    path.write_text(f"{head}{start_marker}\n{table.strip()}\n{end}{tail}", encoding="utf-8")


def require_markers(path: Path, name: str) -> None:
    """Raise InputError for a Markdown file into which `insert_table` cannot insert."""
    _around_table(path, name)


def _around_table(path: Path, name: str) -> tuple[str, str, str, str]:
    """Return the text before the table of `name`, its two markers, and the text after it."""
    start_marker = _start_marker(name)
    end = "<!-- /bench -->"
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        message = f"the file cannot be read: {error.strerror}"
        raise InputError(message, source=path, field="--readme") from error
    head, found, rest = text.partition(start_marker)
    _, closed, tail = rest.partition(end)
    if not (found and closed):
        raise InputError(f"has no {start_marker} … {end}", source=path, field="--readme")
    return head, start_marker, end, tail
