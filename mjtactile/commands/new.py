"""`mjtactile new`: create a commented file as a start, copied from a shipped file."""

from __future__ import annotations

import argparse
import re
from dataclasses import dataclass
from mimetypes import MimeTypes
from pathlib import Path

from mjtactile import InputError
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import print_result, require_new
from mjtactile.core import resources

SIMULATES = False
DESCRIPTION = """\
Write a copy of a shipped controller, sensor, object, scenario, task, variation or rig file,
with its comments, under your own name, and print the next command. An existing file is never
overwritten."""
EPILOG = """\
examples:
  mjtactile new controller firm            firm.py, a copy of `gentle`
  mjtactile new sensor lab/my_sensor       lab/my_sensor.toml, a copy of `dense`
  mjtactile new sensor my_sensor --template dense_fiducials
  mjtactile new object plum --template strawberry
  mjtactile new object sample --template random:7
  mjtactile new scenario my_scene          for `grasp --scenario my_scene.toml`
  mjtactile new task juggle --template shake   for `grasp --task ./juggle.toml`
  mjtactile new variation my_world         for `evaluate --randomization my_world.toml`
  mjtactile new rig my_gripper --template one_xl330_linkage
  mjtactile new rig my_arm --template sim_arm  my_arm.toml, and its robot, my_arm.xml
"""


@dataclass(frozen=True)
class Kind:
    """Kind of file that the command creates.

    It holds folder and suffix of the shipped files, and the file to copy. It also holds the
    documentation page, the next command, and the pattern of the name in the text.
    """

    folder: str
    suffix: str
    template: str
    page: str
    next: str
    name: str = ""


KINDS = {
    "controller": Kind(
        "controllers", ".py", "gentle", "how-to/controllers", "mjtactile grasp --controller {file}"
    ),
    "sensor": Kind(
        "models/sensors",
        ".toml",
        "dense",
        "sensor_files",
        "mjtactile inflate --sensor {file} --pressure-kPa 1",
        r'(?m)^(name = )"[^"]*"',
    ),
    "object": Kind(
        "models/objects",
        ".xml",
        "egg",
        "object_files",
        "mjtactile grasp --object {file}",
        r'(<mujoco model=)"[^"]*"',
    ),
    "scenario": Kind(
        "models/scenarios", ".toml", "lift", "scenario_files", "mjtactile grasp --scenario {file}"
    ),
    "task": Kind("models/tasks", ".toml", "lift", "task_files", "mjtactile grasp --task {file}"),
    "variation": Kind(
        "models/randomization",
        ".toml",
        "default",
        "how-to/evaluate",
        "mjtactile evaluate --randomization {file}",
    ),
    "rig": Kind(
        "models/rigs",
        ".toml",
        "two_xm430",
        "how-to/hardware",
        "mjtactile doctor --rig {file}",
        r'(?m)^(name = )"[^"]*"',
    ),
}
_MODEL = r'(?m)^(model = )"([^"]+\.xml)"'


ARGUMENTS = (
    arg.positional("kind", "KIND", ", ".join(KINDS), choices=list(KINDS)),
    arg.positional("name", "NAME", "name, or path of the file to write", type=Path),
    arg.option(
        "--template SHIPPED",
        "shipped file to copy (default: "
        + ", ".join(f"{kind.template} for a {name}" for name, kind in KINDS.items())
        + ")",
    ),
)


def run(options: argparse.Namespace) -> int:
    kind = KINDS[options.kind]
    template = options.template or kind.template
    random = _random(template) if options.kind == "object" else None
    source = Path(template) if random else _shipped(kind, template)
    if options.name.name in ("", ".."):
        raise InputError("is a folder, not the name of a new file", source=options.name)
    path = _path(options.name, options.kind)
    text = random or source.read_text(encoding="utf-8")
    if kind.name:
        text = re.sub(kind.name, rf'\1"{path.stem}"', text, count=1)
    files = {path: text}
    page = kind.page
    # the rig's robot model is copied into the same folder
    if options.kind == "rig" and (model := re.search(_MODEL, text)):
        robot = path.with_suffix(".xml")
        files[path] = re.sub(_MODEL, rf'\1"{robot.name}"', text, count=1)
        page = "rig_files"
        files[robot] = (source.parent / model.group(2)).read_text(encoding="utf-8")
    for file in files:
        require_new(file, "NAME")
    for file, content in files.items():
        _write(file, content)
    next_step = kind.next.format(
        file=path if path.is_absolute() or len(path.parts) > 1 else f"./{path}"
    )
    print_result(
        options,
        {"file": path, "files": list(files), "like": source.stem, "next": next_step},
        f"{', '.join(map(str, files))}: copied from {source.stem}; edit it, then run\n"
        f"  {next_step}\n"
        f"  mjtactile docs {page}",
    )
    return 0


def _path(name: Path, kind: str) -> Path:
    """Return the path of a file of that kind. A dot in a name is allowed (`v1.2`). Raises
    InputError for the suffix of another type of file."""
    suffix = KINDS[kind].suffix
    if name.suffix == suffix:
        return name
    is_own = name.suffix in {other.suffix for other in KINDS.values()}
    if is_own or MimeTypes(filenames=()).guess_type(name.name)[0]:
        raise InputError(f"a file of kind {kind!r} ends in {suffix}", source=name)
    return name.with_name(name.name + suffix)


def _random(template: str) -> str | None:
    from mjtactile.evaluate.episodes import object_text

    return object_text(template)


def _write(path: Path, text: str) -> None:
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise InputError(f"the file cannot be written: {error.strerror}", source=path) from error


def _shipped(kind: Kind, template: str) -> Path:
    """Return the shipped file of that name. Raises InputError for any other file."""
    if template not in resources.names(kind.folder, kind.suffix):
        raise InputError(
            f"{template!r} is not a shipped file",
            field="--template",
            choices=[
                *resources.names(kind.folder, kind.suffix),
                *(["random:N"] if kind is KINDS["object"] else []),
            ],
        )
    return resources.find(template, kind.folder, kind.suffix)
