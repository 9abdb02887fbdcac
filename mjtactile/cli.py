"""The command line: `mjtactile COMMAND …`. Parses, runs the command, turns errors into one line and an exit code."""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import logging
import os
import signal
import sys
import traceback
from collections.abc import Sequence
from typing import NoReturn

from mjtactile.errors import MjtactileError

DESCRIPTION = """\
A vision-based membrane touch sensor for MuJoCo, and a two-finger gripper that holds
fragile things with it, seeing only through the cameras in its fingers."""

EPILOG = """\
examples:
  mjtactile grasp                                grasp an egg
  mjtactile grasp --object strawberry --seed 3   another object, another noise
  mjtactile grasp --json | python3 -m json.tool  one JSON object on stdout
  mjtactile grasp --help                         all options of a command

exit codes:
  0  done; for `grasp`: the object was held
  1  the object was dropped or crushed
  2  bad usage or bad input: the message names the file, the field and the valid choices
  3  a device or the simulation failed, or the run was interrupted; what was recorded is kept
"""
EXIT_INPUT, EXIT_FAULT = 2, 3


class _Parser(argparse.ArgumentParser):
    """Reports a usage error in one line and where to read on."""

    def error(self, message: str) -> NoReturn:
        raise _UsageError(f"{message} (see {self.prog} --help)")


class _UsageError(MjtactileError):
    exit_code = EXIT_INPUT


def build_parser() -> argparse.ArgumentParser:
    from mjtactile.commands import COMMANDS  # not before `main` has set the number of threads: this imports numpy

    parser = _Parser(prog="mjtactile", description=DESCRIPTION, epilog=EPILOG,
                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--version", action="version", version=f"mjtactile {importlib.metadata.version('mjtactile')}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, command in COMMANDS.items():
        sub = commands.add_parser(name, help=command.HELP, description=command.DESCRIPTION, epilog=command.EPILOG,
                                  formatter_class=argparse.RawDescriptionHelpFormatter)
        command.add_arguments(sub)
        sub.add_argument("--json", action="store_true", help="print one JSON object to stdout, all else to stderr; "
                         'after an error it has the keys "error" and "exit_code"')
        sub.add_argument("--debug", action="store_true", help="show the traceback of an error")
        sub.set_defaults(run=command.run, simulates=getattr(command, "SIMULATES", True))
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (default: the process's own) and return the exit code."""
    argv = sys.argv[1:] if argv is None else list(argv)
    # The matrices here are small: a second BLAS thread only waits for the first (the sensing chain is 2-4 times slower).
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    logging.basicConfig(format="mjtactile: %(levelname)s: %(message)s", level=logging.WARNING, stream=sys.stderr)
    previous = signal.signal(signal.SIGTERM, signal.default_int_handler)  # SIGTERM ends a run like Ctrl-C
    try:
        options = build_parser().parse_args(argv)
        if options.simulates:
            from mjtactile.sim.log import route_warnings  # lazily: half a second that other commands need not wait

            route_warnings()
        return options.run(options)
    except KeyboardInterrupt as stop:  # Ctrl-C, or SIGTERM
        return _fail(stop, argv)
    except BrokenPipeError:  # the reader of our output left: no fault of the run
        sys.stderr.close()
        return 0
    except Exception as error:  # noqa: BLE001  # the last resort: every error ends as one line
        return _fail(error, argv)
    finally:
        signal.signal(signal.SIGTERM, previous)


def _fail(error: BaseException, argv: Sequence[str]) -> int:
    """Report `error` in one line (in JSON too, if asked for) and return its exit code."""
    if "--debug" in argv:
        traceback.print_exception(error)
    code, text = EXIT_FAULT, " ".join(str(error).split())
    if isinstance(error, MjtactileError):
        code = error.exit_code
    elif isinstance(error, KeyboardInterrupt):
        text = "interrupted"
    else:
        text = f"internal error: {type(error).__name__}: {text} (--debug shows where)"
    print(f"mjtactile: {text}", file=sys.stderr)
    if "--json" in argv:
        print(json.dumps(getattr(error, "summary", {}) | {"error": text, "exit_code": code}, indent=2, allow_nan=False))
    return code


if __name__ == "__main__":
    sys.exit(main())
