"""`mjtactile studio`: a grasp watched live in the browser."""

from __future__ import annotations

import argparse
import sys

from mjtactile import rig_names
from mjtactile.commands import effects
from mjtactile.commands.grasp import seed

DESCRIPTION = """\
Watch a grasp live in MuJoCo Studio, in the browser: the scene with the membranes and the
forces that are felt, what each camera sees with its ellipses, force, shear, area and slip of
each finger, forces over time beside the true ones. Pause it, go on cycle by cycle, open and
close the valves, pull at the object with the mouse (double-click it, then Ctrl and drag), and
run it again with the next seed. The page is served on this computer alone (loopback)."""
EPILOG = """\
examples:
  mjtactile studio                             prints an address to open
  mjtactile studio --object raspberry --controller my_controller.py --port 8080
  mjtactile studio --rig emulated              on a rig that is not simulated: the fingers, no scene
  ssh -L 8080:localhost:8080 HOST              then open http://localhost:8080 here for one that runs there

exit codes: 0 ended by closing it, 2 bad input, 3 a device or the simulation failed, or Ctrl-C.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--object", default="egg", metavar="NAME|FILE.xml", help="as for `grasp` (default: egg)")
    parser.add_argument("--sensor", default="dense", metavar="NAME|FILE.toml", help="as for `grasp` (default: dense)")
    parser.add_argument("--controller", default="gentle", metavar="NAME|FILE.py", help="as for `grasp` (default: gentle)")
    parser.add_argument("--rig", default="sim", metavar="RIG", help=f"{', '.join(rig_names())} (default: sim)")
    parser.add_argument("--seed", type=seed, default=0, metavar="N", help="of the first run; the next has the next (default: 0)")
    effects.add_shared_arguments(parser)
    parser.add_argument("--port", type=_port, default=0, metavar="N", help="of the page (default: the first free one from 8080)")
    parser.add_argument("--no-browser", action="store_true", help="do not open a browser")
    parser.add_argument("--fast", action="store_true", help="as fast as the simulation goes, not by the clock")


def _port(text: str) -> int:
    if not text.isdecimal() or not 0 < int(text) < 65536:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port from 1 to 65535")
    return int(text)


def run(options: argparse.Namespace) -> int:
    from mjtactile.run.grasp import GraspOptions
    from mjtactile.studio.serve import watch
    from mjtactile.studio.show import Show

    show = Show(say=lambda text: print(text, file=sys.stderr, flush=True))
    show.fastest = float("inf") if options.fast else 1.0
    names = ("object", "sensor", "controller", "rig", "seed", "accuracy", "effects")
    watch(GraspOptions(**{name: getattr(options, name) for name in names}), show, port=options.port,
          browser=not options.no_browser)
    return 0
