"""The options that make a scenario, the same for every command that runs one."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mjtactile import Scenario, complete_scenario, load_scenario, rig_names
from mjtactile.core import resources

_ALL = (
    "object",
    "sensor",
    "controller",
    "rig",
    "seed",
    "accuracy",
    "effects",
    "vary",
    "task",
    "shapes",
)


def seed(text: str) -> int:
    """A seed as argparse takes it."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 up")
    return int(text)


def _shipped(folder: str, suffix: str) -> str:
    return ", ".join(resources.names(folder, suffix))


def _option(name: str) -> dict[str, Any]:
    """What argparse is told of the option `--name`, without its default."""
    if name == "object":
        shipped = _shipped("models/objects", ".xml")
        text = f"what to grasp: {shipped}, random:N (one of many), or your own MJCF file"
        return {"metavar": "NAME|FILE.xml", "help": text}
    if name == "sensor":
        text = f"on each finger: {_shipped('models/sensors', '.toml')}, or your own file"
        return {"metavar": "NAME|FILE.toml", "help": text}
    if name == "controller":
        text = f"what moves: {_shipped('controllers', '.py')}, or your own file"
        return {"metavar": "NAME|FILE.py", "help": text}
    if name == "rig":
        return {"metavar": "RIG", "help": f"what to run it on: {', '.join(rig_names())}"}
    if name == "seed":
        text = "seed of the camera noise and of where the object stands"
        return {"metavar": "N", "type": seed, "help": text}
    if name == "accuracy":
        text = "simulate as coarsely as this force error or real time allows"
        return {"metavar": "0.02N|realtime", "help": text}
    if name == "effects":
        text = "what to simulate: derived from the scene (auto), or effects forced on and off"
        return {"metavar": "auto|+NAME,-NAME", "help": text}
    if name == "shapes":
        text = (
            "say of every touch what body it is of, whatever the controller reads; area and force "
            "are then that body's (docs/effects.md has the price)"
        )
        return {"action": "store_true", "default": None, "help": text}
    if name == "vary":
        text = (
            "ranges of object, sensor, gas and rig, from which the seed draws the simulated "
            f"world: {_shipped('models/variations', '.toml')}, none, or your own file"
        )
        return {"metavar": "NAME|FILE.toml", "help": text}
    text = f"what is done with it: {_shipped('models/tasks', '.toml')}, or your own file"
    return {"metavar": "NAME|FILE.toml", "help": text}


def add_arguments(
    parser: argparse.ArgumentParser,
    default: Scenario | None = None,
    *,
    leave_out: Sequence[str] = (),
) -> None:
    """--scenario, and an option for each field; what is not given stays None.

    Args:
        parser: Of the command.
        default: Whose values the help names.
        leave_out: Fields that the command has no option for.
    """
    parser.add_argument(
        "--scenario",
        metavar="FILE",
        help="take all of the following from a scenario file (FILE.toml), or from a run's result "
        "(RUN/summary.json); options on the command line are stronger",
    )
    said = (default or Scenario()).to_dict() | {"accuracy": "a mesh of 13 x 11"}
    for name in _ALL:
        if name not in leave_out:
            option = _option(name)
            if "action" not in option:
                option["help"] += f" (default: {said[name]})"
            parser.add_argument(f"--{name}", **option)


def scenario_of(options: argparse.Namespace, default: Scenario | None = None) -> Scenario:
    """The scenario that a command's options say, with the sensor that each finger really has.

    Args:
        options: As parsed.
        default: What holds where neither an option nor --scenario says otherwise.

    Raises:
        InputError: For a file or a value that is wrong.
    """
    base = default or Scenario()
    if getattr(options, "scenario", None):
        base = load_scenario(options.scenario)
    given = {name: getattr(options, name, None) for name in _ALL}
    said = {name: value for name, value in given.items() if value is not None}
    if "sensor" in said:
        base = replace(base, sensors={})
    return complete_scenario(replace(base, **said))


def stem(scenario: Scenario) -> str:
    """What a folder of its results is called after."""
    return Path(scenario.object).stem
