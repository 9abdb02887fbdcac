"""The command line: `mjtactile COMMAND …`. Parses, runs the command, turns errors into one line and
an exit code."""

from __future__ import annotations

import argparse
import contextlib
import errno
import gc
import importlib
import json
import logging
import os
import sys
import traceback
from collections.abc import Sequence
from functools import partial
from typing import Any, NoReturn

from mjtactile.commands import COMMANDS, arguments, option_rules
from mjtactile.core import platform_support, signals
from mjtactile.core.errors import MjtactileError
from mjtactile.core.renamed import explain_option

DESCRIPTION = """\
A vision-based tactile membrane sensor for MuJoCo, and a two-finger gripper that grasps fragile
objects with it, using only the cameras in its fingers."""

EPILOG = """\
examples:
  mjtactile grasp                                grasp an egg
  mjtactile grasp --object strawberry --seed 3   another object, other noise
  mjtactile grasp --json | python3 -m json.tool  one JSON object on stdout
  mjtactile grasp --help                         all options of a command

exit codes:
  0  done; for `grasp`: the object was held
  1  the object was dropped or crushed
  2  bad usage or bad input: the message names the file, the field and the valid choices
  3  a device or the simulation failed, or the run was interrupted; recorded data are kept
"""
_SHARED = (
    arguments.flag(
        "--json",
        "print one JSON object to stdout, all other output to stderr; after an error it has "
        'the keys "error" and "exit_code"',
    ),
    arguments.flag("--debug", "show the traceback of an error"),
)
EXIT_INPUT = 2
EXIT_FAULT = 3
_NAMES = (errno.ENAMETOOLONG, errno.ELOOP)
"""Errors of a path that no file can have."""
_SHOWN = 80  # characters of such a path in a message


class _Parser(argparse.ArgumentParser):
    """Parser with one-line errors that point to the help; accepts values with a leading minus.

    `command` is the command to parse, which renamed options depend on.
    """

    command = ""

    def _parse_optional(self, arg_string: str) -> Any:
        """Return None for values with one dash, such as `--position-mm -3.2,1.7` and `--effects
        -latency`. Every option here has two dashes."""
        is_value = (
            arg_string.startswith("-")
            and not arg_string.startswith("--")
            and arg_string not in ("-", "-h")
        )
        return None if is_value else super()._parse_optional(arg_string)

    def error(self, message: str) -> NoReturn:
        explained = explain_option(message, self.command)
        # the main parser reports them, after the command's parser
        is_left = message.startswith("unrecognized arguments") and self.command
        help_of = f"{self.prog} {self.command}" if is_left else self.prog
        raise _UsageError(f"{explained} (see {help_of} --help)")


class _Version(argparse.Action):
    """Option that looks up the version only on request.

    The lookup takes as long as a third of `--help`.
    """

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        from importlib.metadata import version

        print(f"mjtactile {version('mjtactile')}")
        parser.exit()


class _UsageError(MjtactileError):
    exit_code = EXIT_INPUT


def build_parser(*requested: str) -> argparse.ArgumentParser:
    """Build the parser with the options of the `requested` commands; the other commands are not
    imported."""
    parser = _Parser(
        prog="mjtactile",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.command = next(iter(requested), "")
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, text in COMMANDS.items():
        if name not in requested:
            commands.add_parser(name, help=text, add_help=False)
            continue
        command = importlib.import_module(f"mjtactile.commands.{name.replace('-', '_')}")
        sub = commands.add_parser(
            name,
            help=text,
            description=command.DESCRIPTION,
            epilog=command.EPILOG,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        arguments.add(sub, (*command.ARGUMENTS, *_SHARED))
        rules = getattr(command, "RULES", ())
        check_rules = partial(option_rules.check, arguments=command.ARGUMENTS, rules=rules)
        simulates = getattr(command, "SIMULATES", True)
        sub.set_defaults(run=command.run, check_rules=check_rules, simulates=simulates)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (default: the process's own, which ends with it) and return the
    exit code."""
    if not platform_support.is_supported():
        print(f"mjtactile: {platform_support.REFUSAL}", file=sys.stderr)
        return EXIT_INPUT
    _open_streams()
    with signals.listening(ends_process=argv is None):
        code = _main(sys.argv[1:] if argv is None else list(argv))
        _flush_streams()
        return code


def _main(argv: list[str]) -> int:
    # The matrices are small: a second BLAS thread only waits for the first (the sensing pipeline is
    # 2-4 times slower). OpenCV's thread would spin in parallel to the simulation for a twentieth of
    # the loop's time.
    for name in (
        "OPENBLAS_NUM_THREADS",
        "OMP_NUM_THREADS",
        "MKL_NUM_THREADS",
        "OPENCV_FOR_THREADS_NUM",
    ):
        os.environ.setdefault(name, "1")
    # imports create many objects and free few; collection would take a tenth of their time
    gc.set_threshold(100_000)
    _quieten_libraries(debug="--debug" in argv)
    logging.basicConfig(
        format="mjtactile: %(levelname)s: %(message)s", level=logging.WARNING, stream=sys.stderr
    )
    try:
        options = build_parser(*argv[:1]).parse_args(argv)
        options.check_rules(options)
        if options.simulates:
            # lazily: half a second that other commands need not wait
            from mjtactile.sim.mujoco_log import route_warnings

            route_warnings()
        return options.run(options)
    except KeyboardInterrupt as stop:  # Ctrl-C, or another of these signals
        return _fail(stop, argv)
    except BrokenPipeError:  # the reader of our output left: no fault of the run
        return 0
    except Exception as error:  # noqa: BLE001  # the last resort: every error ends as one line
        return _fail(error, argv)


def _quieten_libraries(*, debug: bool) -> None:
    """Suppress output that OpenCV, FFmpeg and MuJoCo print themselves.

    mjtactile reports such problems as one line: an error, or a flag of the run.
    """
    # a file of 2 MB may hold a thousand times as many pixels (core/image_decoding.py)
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 26))
    if not debug:
        # read when cv2 is imported, in child processes too
        os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    logging.getLogger("mjtactile.mujoco").setLevel(logging.WARNING if debug else logging.ERROR)


def _fail(error: BaseException, argv: Sequence[str]) -> int:
    """Report `error` in one line (in JSON too, if requested) and return its exit code."""
    code = EXIT_FAULT
    text = " ".join(str(error).split())
    if isinstance(error, MjtactileError):
        code = error.exit_code
    elif isinstance(error, KeyboardInterrupt):
        text = "interrupted"
    elif isinstance(error, OSError) and error.errno in _NAMES:
        code = EXIT_INPUT
        text = f"{str(error.filename or 'a path')[:_SHOWN]}…: {error.strerror}"
    elif isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        text = f"{error.filename or 'the output'}: cannot be written: {error.strerror}"
    else:
        text = f"internal error: {type(error).__name__}: {text} (--debug shows where)"
    # a file name may have bytes that no encoding has
    text = text.encode("utf-8", "backslashreplace").decode()
    with contextlib.suppress(OSError):  # stderr or stdout is closed
        if "--debug" in argv:
            traceback.print_exception(error)
        print(f"mjtactile: {text}", file=sys.stderr)
        if "--json" in argv:
            print(
                json.dumps(
                    getattr(error, "summary", {}) | {"error": text, "exit_code": code},
                    indent=2,
                    allow_nan=False,
                )
            )
    return code


def _open_streams() -> None:
    """Open /dev/null for a missing stdin, stdout or stderr. Otherwise a device could get one of
    these descriptors and receive the text written to stderr."""
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # uses the lowest free number, which is this one
            setattr(sys, name, open(descriptor, "w" if descriptor else "r", closefd=False))  # noqa: SIM115


def _flush_streams() -> None:
    """Flush the output buffers. After a failure, redirect to /dev/null: Python's own flush at exit
    would change the exit code."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            with contextlib.suppress(OSError):
                null = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null, stream.fileno())
                os.close(null)


if __name__ == "__main__":
    sys.exit(main())
