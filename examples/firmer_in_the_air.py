"""A controller that commands the air: soft fingers to find an egg, firm ones to hold it.

mjtactile grasp --controller examples/firmer_in_the_air.py

The shipped controller grasps; beside it, this one says how much pressure the fingers' chambers
keep. At 0.6 kPa a membrane gives way to a light touch; at 2 kPa it carries what it has without
swaying. The rig goes from one to the other as fast as its valves may
(1.2 kPa/s), and what is felt meanwhile is right: the sensing chain looks at the chambers' gauges.
"""

from dataclasses import replace

from mjtactile import Command, Observation, load_controller

SOFT = 600.0  # Pa above ambient
FIRM = 2000.0
IN_THE_AIR = ("hold", "lower", "release")

gentle = load_controller("gentle")


def step(observation: Observation) -> Command:
    """What the shipped controller does, with the air beside it."""
    command = gentle.step(observation)
    pressure = FIRM if command.phase in IN_THE_AIR else SOFT
    return replace(command, gauge_pressure=(pressure,) * len(observation.touch))
