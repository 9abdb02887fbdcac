"""Options of scenarios and rigs, the same for every command that runs one."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mjtactile import InputError, Scenario, load_scenario, resolve_scenario, rig_names
from mjtactile.commands import arguments as arg
from mjtactile.core import resources, scaled_clock


def _shipped(folder: str, suffix: str) -> str:
    return ", ".join(resources.names(folder, suffix))


_SCENARIO = arg.option(
    "--scenario FILE",
    "read all of the following from a scenario file (FILE.toml), or from a run's result "
    "(RUN/summary.json); options on the command line override it",
)
_SHAPES = arg.flag(
    "--contact-shapes",
    "force and slip from the contact shape in every image, even if the controller does not read "
    "it; area and kind always come from it (docs/reference/effects.md has the cost)",
    default=None,
)


_VALUES = {
    "object": (
        "NAME|FILE.xml",
        f"object to grasp: {_shipped('models/objects', '.xml')}, random:N (one of many), or "
        "your own MJCF file",
    ),
    "sensor": (
        "NAME|FILE.toml",
        f"sensor on each finger: {_shipped('models/sensors', '.toml')}, or your own file",
    ),
    "controller": (
        "NAME|FILE.py",
        f"controller: {_shipped('controllers', '.py')}, or your own file",
    ),
    "rig": ("RIG", f"rig to run on: {', '.join(rig_names())}"),
    "seed": ("N", "seed of the camera noise and of the object position"),
    "accuracy": ("0.02N|realtime", "coarsest simulation within this force error, or in real time"),
    "effects": (
        "auto|+NAME,-NAME",
        "effects to simulate: derived from the scene (auto), or forced on and off",
    ),
    "randomization": (
        "NAME|FILE.toml",
        "ranges of object, sensor, gas and rig, from which the seed samples the simulated "
        f"world: {_shipped('models/randomization', '.toml')}, none, or your own file",
    ),
    "task": (
        "NAME|FILE.toml",
        f"task with the object: {_shipped('models/tasks', '.toml')}, or your own file",
    ),
}
"""Fields of a scenario with the name of their value in the help, and its description."""
_FIELDS = (*_VALUES, "contact_shapes")


def arguments(
    default: Scenario | None = None, *, leave_out: Sequence[str] = ()
) -> tuple[arg.Argument, ...]:
    """Return --scenario and an option for each field that is not in `leave_out`.

    Options that are not given stay None. The help shows the values of `default`.
    """
    values = (default or Scenario()).to_dict() | {"accuracy": "mesh of 13 x 11"}
    options = tuple(
        arg.option(
            f"--{name} {metavar}",
            f"{text} (default: {values[name]})",
            type=arg.integer(0) if name == "seed" else str,
        )
        for name, (metavar, text) in _VALUES.items()
        if name not in leave_out
    )
    return _SCENARIO, *options, *(() if "contact_shapes" in leave_out else (_SHAPES,))


def scenario_of(options: argparse.Namespace, default: Scenario | None = None) -> Scenario:
    """Return the scenario given by a command's options, with the resolved sensor of each finger.

    The values of `default` apply if neither an option nor --scenario sets them. Raises InputError
    for a controller file that no option names.
    """
    base = default or Scenario()
    has_file = getattr(options, "scenario", None) is not None
    if has_file:
        base = load_scenario(options.scenario)
    values = {name: getattr(options, name, None) for name in _FIELDS}
    given = {name: value for name, value in values.items() if value is not None}
    chosen = {*given, *(base.given if has_file else ())}
    if "sensor" in given:
        base = replace(base, sensors={})
        chosen.discard("sensors")
    requested = resolve_scenario(_with_options(base, given), tuple(chosen))
    if hasattr(options, "controller") and "controller" not in given:
        _require_named(requested)
    return requested


def _with_options(base: Scenario, given: dict[str, Any]) -> Scenario:
    """Return `base` with the options. Raises InputError naming a wrong one."""
    try:
        return replace(base, **given)
    except InputError as error:
        if error.source is None and error.field in given:
            raise error.at(f"--{error.field}") from None
        raise


def _require_named(requested: Scenario) -> None:
    """Raise InputError for a controller file that only a scenario file or a recording names.

    Such a file is code, and its name may come from another person.
    """
    name = requested.controller
    if name in resources.names("controllers", ".py"):
        return
    raise InputError(
        f"the controller {name!r} is a program and is run only if it is given as an option",
        field="--controller",
        choices=[f"--controller {shlex.quote(name)}", *resources.names("controllers", ".py")],
    )


def stem(scenario: Scenario) -> str:
    """Return the name for folders with results of this scenario."""
    return Path(scenario.object).stem


TIME_SCALE = arg.option(
    "--time-scale N",
    "emulated rig: run its world, watchdogs and heartbeats, and this program's time-outs, at "
    "1/N of the speed, for a slow computer (default: 1)",
    type=arg.number(1, 100),
)


def apply_time_scale(slow: float | None, rig: str) -> None:
    """Set the time scale of this run. Raises InputError for a rig that has no clock."""
    if slow is None:
        return
    if rig == "sim" or rig.startswith("replay:"):
        message = f"the rig {rig!r} has no clock; only emulated devices can run slower"
        raise InputError(message, field="--time-scale")
    scaled_clock.set_slow(slow)


def _frames(text: str) -> int:
    """Read "none" (0), "all" (1) or "every:N" (N)."""
    word, _, number = text.partition(":")
    if word == "every" and number.isdecimal() and int(number) > 0:
        return int(number)
    if text not in ("none", "all"):
        raise argparse.ArgumentTypeError(f"{text!r} is not none, every:N or all")
    return int(text == "all")


FRAMES = arg.option(
    "--frames none|every:N|all",
    "camera images kept in the recording: none, of every N-th cycle, or all (default). "
    "Without all of them it cannot be replayed; two cameras take 9 MB per second",
    1,
    type=_frames,
)
