"""`mjtactile studio`: a grasp watched live in the browser."""

from __future__ import annotations

import argparse
import sys

from mjtactile import load_recording
from mjtactile.commands import arguments as arg
from mjtactile.commands import scenario
from mjtactile.commands.option_rules import Rule, replays

DESCRIPTION = """\
Watch a grasp live in MuJoCo Studio, in the browser: the scene, the membranes colored by
indentation or traction, the estimated forces, each camera image with its ellipses, force,
shear, area, slip and gas of each finger, and the forces over time next to ground truth. Pause
it, step cycle by cycle, override the controller and move jaws and lift by hand, squeeze with a
given force, open and close the valves, puncture a membrane, pull the object with the mouse
(double-click it, then Ctrl and drag), and run it again with another object, seed, accuracy or
other effects. A recording can be scrubbed. The page is served on this computer only (loopback)."""
EPILOG = """\
examples:
  mjtactile studio                             prints an address to open
  mjtactile studio --object raspberry --controller my_controller.py --port 8080
  mjtactile studio --rig emulated              on a rig that is not simulated: fingers only
  mjtactile studio --rig replay:runs/egg       a recording, with a slider for the time
  ssh -L 8080:localhost:8080 HOST
      then open http://localhost:8080 here for a Studio that runs there

exit codes: 0 closed by the user, 2 bad input, 3 a device or the simulation failed, or Ctrl-C.
"""


ARGUMENTS = (
    *scenario.arguments(leave_out=("randomization",)),
    scenario.TIME_SCALE,
    arg.option(
        "--port N",
        "port of the page (default: the first free one from 8080)",
        0,
        type=arg.integer(1, 65535),
    ),
    arg.OneOf(
        (
            arg.flag("--web", "show it in the browser (this is the default)"),
            arg.flag("--native", "show it in MuJoCo's own window, which needs a display"),
        )
    ),
    arg.flag("--no-browser", "do not open a browser"),
    arg.flag("--no-wait", "start at once, before the page is open"),
    arg.flag("--no-realtime", "run as fast as the simulation allows, not in real time"),
)
RULES = (
    Rule(
        ("--port", "--no-browser", "--no-wait"),
        lambda given: not given.native,
        "with --native, which has no page",
    ),
    Rule(
        ("--controller", "--task", "--contact-shapes", "--seed", "--effects", "--accuracy"),
        lambda given: not replays(given),
        "on a recording, which is only shown",
    ),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile.studio.playback import RecordingPlayer
    from mjtactile.studio.serve import watch
    from mjtactile.studio.session_bridge import SessionBridge

    def notify(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    requested = scenario.scenario_of(options)
    scenario.apply_time_scale(options.time_scale, requested.rig)
    backend, _, folder = requested.rig.partition(":")
    if backend == "replay" and folder:
        bridge = RecordingPlayer(requested, load_recording(folder), notify)
    else:
        bridge = SessionBridge(requested, notify)
    bridge.fastest = float("inf") if options.no_realtime else 1.0
    watch(
        bridge,
        port=options.port,
        browser=not options.no_browser,
        native=options.native,
        wait=not options.no_wait,
    )
    return 0
