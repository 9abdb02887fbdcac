"""`mjtactile emulate`: emulated hardware for any client, until it is stopped."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from mjtactile import InputError
from mjtactile.commands import arguments as arg
from mjtactile.commands import scenario
from mjtactile.commands.output import require_new
from mjtactile.core import resources

DESCRIPTION = """\
Start emulated servos, a valve board and cameras around a simulated grasp, in real time, and
print a rig file for them. Any client can connect: this package's drivers (--rig FILE), the
Dynamixel SDK, a serial terminal, a browser. Runs until Ctrl-C."""
EPILOG = """\
examples:
  mjtactile emulate --out rig.toml
  mjtactile grasp --rig rig.toml                  in another terminal
  mjtactile emulate --faults servo_drop=0.01 --faults frames_dark=1

faults can also be switched at run time: enter `servo_overload 1`;
`servo_overload 0` ends the fault.
"""

_HEAD = "# Written by `mjtactile emulate`, whose next run may replace it: ports are new then\n"


ARGUMENTS = (
    arg.option(
        "--scene --object NAME|FILE.xml",
        f"object on the table: {', '.join(resources.names('models/objects', '.xml'))}, or "
        "your own MJCF file (default: egg)",
        "egg",
        dest="object",
    ),
    arg.sensor("sensor on each finger"),
    arg.option(
        "--rig NAME|FILE.toml", "rig file of the servos, valves and cameras to emulate", "emulated"
    ),
    arg.option("--seed N", "seed of placement and noise", 0, type=arg.integer(0)),
    scenario.TIME_SCALE,
    arg.repeated("--faults KIND=VALUE", "fault from the start; repeatable"),
    arg.out(
        "also write the rig file here; only the file of an earlier run is overwritten", "FILE.toml"
    ),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile import load_rig_file, load_sensor
    from mjtactile.emulator.process import EmulatorProcess

    scenario.apply_time_scale(options.time_scale, options.rig)
    rig_file = load_rig_file(options.rig)
    if options.out is not None and not _is_own(options.out):
        require_new(options.out)
    faults = dict(_fault(text) for text in options.faults)
    emulator = EmulatorProcess(
        rig_file,
        load_sensor(options.sensor),
        object_name=options.object,
        seed=options.seed,
        faults=faults,
    )
    try:
        text = client_text(rig_file.path, emulator.endpoints)
        if options.out is not None:
            _write(options.out, _HEAD + text)
        print(text)
        print("emulated hardware is running; Ctrl-C stops it", file=sys.stderr, flush=True)
        _read_faults(emulator)
    except KeyboardInterrupt:
        pass
    finally:
        emulator.close()
    return 0


def _is_own(path: Path) -> bool:
    """Return True if an earlier run wrote the file. Its ports no longer exist, so it may be
    replaced."""
    try:
        with path.open(encoding="utf-8") as file:
            return file.readline() == _HEAD
    except (OSError, ValueError):
        return False


def _fault(text: str) -> tuple[str, float]:
    """Parse and check KIND=VALUE or "KIND VALUE". Raises InputError with the kinds that exist."""
    from mjtactile.emulator.faults import KINDS

    kind, _, value = text.replace("=", " ").partition(" ")
    if kind not in KINDS:
        raise InputError(f"unknown fault {kind!r}", field="--faults", choices=KINDS)
    try:
        return kind, float(value or 1)
    except ValueError as error:
        raise InputError(f"{value!r} is not a number", field=f"--faults {kind}") from error


def _read_faults(emulator) -> None:
    """Switch faults entered on stdin. Continue if stdin ends and is not a terminal."""
    from mjtactile import MjtactileError

    for line in sys.stdin:
        try:
            emulator.fault(*_fault(line.strip()))
            print(f"ok: {line.strip()}", file=sys.stderr, flush=True)
        except MjtactileError as error:
            print(error, file=sys.stderr, flush=True)
    while True:
        import time

        time.sleep(1.0)
        emulator.truth()  # raises when the emulator has ended


def client_text(path: Path, endpoints: dict) -> str:
    """Return a client's rig file with real addresses and without [emulator].

    It may be stored in another folder.
    """
    lines = []
    section = ""
    camera = iter(endpoints["cameras"].values())
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            section = line.split("#")[0].strip("[] ")
        if section.split(".")[0] == "emulator":
            continue
        key, _, value = (part.strip() for part in line.partition("="))
        if key == "port":
            line = f'port = "{endpoints["servo" if section == "bus" else "valve"]}"'
        elif key == "source":
            line = f'source = "{next(camera)}"'
        elif key == "calibration" or key == "sensor" and ".toml" in value:
            line = f'{key} = "{path.parent.resolve() / value.split(chr(34))[1]}"'
        lines.append(line)
    return "\n".join(lines) + "\n"


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(
            f"the file cannot be written: {error.strerror}", source=path, field="--out"
        ) from error
