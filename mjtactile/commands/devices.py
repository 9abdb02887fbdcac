"""`mjtactile devices`: list connected devices, their names, and the replies on serial ports."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from mjtactile.commands import arguments as arg
from mjtactile.commands.output import print_json, stdout_to_stderr
from mjtactile.doctor import plugged_in

DESCRIPTION = """\
List cameras with what they can send, and serial ports with who answers there: Dynamixel servos by
ping, valve boards by their name. The names printed are those to write into a rig file: they stay
when a cable is plugged in again. Nothing is set and nothing moves; but opening a port restarts
many boards, and a device that is neither may take a ping for something else (--no-ask)."""
EPILOG = """\
examples:
  mjtactile devices
  mjtactile devices --no-ask                   names only
  mjtactile devices --port socket://host:7000  a port that no computer lists, too
"""
SIMULATES = False


ARGUMENTS = (
    arg.flag("--no-ask", "open no serial port"),
    arg.repeated("--port", "PATH", "also ask this port; again for each one"),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile.runtime.progress import Progress

    with stdout_to_stderr():
        cameras, ports = plugged_in(options.port, ask=not options.no_ask, say=Progress().message)
    if options.json:
        print_json(
            {
                "cameras": [asdict(camera) for camera in cameras],
                "serial_ports": [asdict(port) | {"answers": port.answers} for port in ports],
            }
        )
        return 0
    for camera in cameras:
        print(f"camera       {camera.path}\n             {_description(camera)}")
        for fourcc, width, height, rate in camera.formats:
            print(f"               {fourcc} {width} x {height}, up to {rate:g} Hz")
    for port in ports:
        print(f"serial port  {port.path}\n             {_description(port)}")
        no_answer = port.problem or ("not asked" if options.no_ask else "nobody known answers")
        for answer in port.answers or (no_answer,):
            print(f"               {answer}")
    missing = [name for name, found in (("cameras", cameras), ("serial ports", ports)) if not found]
    if missing:
        print(
            f"no {' and no '.join(missing)}: are they plugged in? In a container, pass their "
            "devices through"
        )
    return 0


def _description(found: Any) -> str:
    """Describe further properties of a device, omitting unknown ones."""
    about = getattr(found, "name", "") or getattr(found, "description", "")
    return (
        ", ".join(
            part
            for part in (
                about,
                found.device if found.device != found.path else "",
                f"serial number {found.serial}" if found.serial else "",
            )
            if part
        )
        or "no name"
    )
