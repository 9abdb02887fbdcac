"""`mjtactile devices`: list connected devices, their names, and the replies on serial ports."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from mjtactile.commands import arguments as arg
from mjtactile.commands.output import print_json, stdout_to_stderr
from mjtactile.doctor import plugged_in

DESCRIPTION = """\
List cameras with their formats, and serial ports with the devices that answer: Dynamixel servos
to a ping, valve boards with their name. Use the printed names in a rig file: they stay the same
when a cable is plugged in again. Nothing is set and nothing moves; but opening a port restarts
many boards, and other devices may misinterpret a ping (--no-ask)."""
EPILOG = """\
examples:
  mjtactile devices
  mjtactile devices --no-ask                   names only
  mjtactile devices --port socket://host:7000  also a port that the computer does not list
"""
SIMULATES = False


ARGUMENTS = (
    arg.flag("--no-ask", "open no serial port"),
    arg.repeated("--port PATH", "also query this port; repeatable"),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile.runtime.progress import Progress

    with stdout_to_stderr():
        cameras, ports = plugged_in(options.port, ask=not options.no_ask, notify=Progress().message)
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
        no_answer = port.problem or ("not asked" if options.no_ask else "no known device answers")
        for answer in port.answers or (no_answer,):
            print(f"               {answer}")
    missing = [name for name, found in (("cameras", cameras), ("serial ports", ports)) if not found]
    if missing:
        print(
            f"no {' and no '.join(missing)} found: check the cables; in a container, pass the "
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
