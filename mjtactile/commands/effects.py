"""`mjtactile effects`: list the effects that a scene requires, with the reasons.

It also lists the cost of each effect, and the cost of leaving it out.
"""

from __future__ import annotations

import argparse

from mjtactile import load_sensor
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import print_json
from mjtactile.core import resources

DESCRIPTION = """\
List every effect of the simulator: whether it is on for this sensor, object and accuracy, the
reason, its cost (ms of one core per simulated second, two sensors or two cameras) and the error
without it (mN of force, um of surface), as measured on the shipped sensors."""
EPILOG = """\
examples:
  mjtactile effects
  mjtactile effects --object vial --accuracy 0.005N
  mjtactile effects --effects +bending,-friction

JSON: {"sensor", "object", "effects": [{"effect", "kind", "on", "built", "why",
"cost_ms_per_s", "left_out_N", "left_out_um"}]}
"""


SHARED = (
    arg.option(
        "--accuracy 0.02N|realtime",
        "coarsest simulation with this force error or real-time factor (default: the command's "
        "own mesh)",
    ),
    arg.option(
        "--effects auto|+NAME,-NAME",
        "effects to simulate: derived from the scene (default), or forced on and off",
        "auto",
    ),
)
"""--accuracy and --effects, the same for every command that simulates."""
ESTIMATE = arg.flag(
    "--error-estimate",
    "repeat the simulation on a coarser mesh and report the estimated force error (N)",
)
ARGUMENTS = (
    arg.sensor(
        f"{', '.join(resources.names('models/sensors', '.toml'))}, or your own (default: dense)"
    ),
    arg.option(
        "--object NAME|FILE.xml",
        f"{', '.join(resources.names('models/objects', '.xml'))}, or your own (default: egg)",
        "egg",
    ),
    *SHARED,
)


# keys: implemented or not, on or off
_STATES = {
    (True, True): "on",
    (True, False): "off",
    (False, True): "requested",
    (False, False): "none",
}


def run(options: argparse.Namespace) -> int:
    from mjtactile.experiments.fidelity_options import effects_of

    design = load_sensor(options.sensor)
    accuracy = options.accuracy or ""
    grasped, requested, rows = effects_of(design, options.object, accuracy, options.effects)
    if options.json:
        print_json(
            {"sensor": design.name, "object": grasped, "force_error_N": requested, "effects": rows}
        )
        return 0
    print(f"sensor {design.name}, object {grasped}, force error {1e3 * requested:.3g} mN")
    print(f"{'effect':<24}{'':<10}{'costs ms/s':>10}{'else mN':>9}{'else um':>9}  why")
    for row in rows:
        state = _STATES[row["built"], row["on"]]
        why = row["why"] if row["built"] else f"{row['why']}; not implemented: {row['kind']}"
        measured = (
            f"{_cost(row['cost_ms_per_s']):>10}{_cell(1e3 * row['left_out_N']):>9}"
            f"{_cell(row['left_out_um']):>9}"
        )
        print(f"{row['effect']:<24}{state:<10}{measured}  {why}")
    return 0


def _cost(value: float) -> str:
    """Format a cost; one that was measured below zero is below the measurement's noise."""
    return "about 0" if value <= 0 else _cell(value)


def _cell(value: float) -> str:
    return "-" if value != value else f"{value:.3g}"
