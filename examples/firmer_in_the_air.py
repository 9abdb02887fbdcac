"""Controller that sets the air pressure: soft fingers to find an egg, firm ones to hold it.

mjtactile grasp --controller examples/firmer_in_the_air.py

The shipped controller grasps. This one adds the pressure of the fingers' chambers. At 0.6 kPa a
membrane yields to a light touch; at 2 kPa it holds the object without sway. The rig changes the
pressure as fast as its valves allow (1.2 kPa/s). Estimates remain correct meanwhile, since the
sensing pipeline reads the chambers' pressure sensors.
"""

from dataclasses import replace

from mjtactile import Command, Observation, load_controller

SOFT = 600.0  # gauge pressure, Pa
FIRM = 2000.0
IN_THE_AIR = ("hold", "lower", "release")

gentle = load_controller("gentle")


def step(observation: Observation) -> Command:
    """Return the shipped controller's command with a gauge pressure."""
    command = gentle.step(observation)
    pressure = FIRM if command.phase in IN_THE_AIR else SOFT
    return replace(command, gauge_pressure=(pressure,) * len(observation.touch))
