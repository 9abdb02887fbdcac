"""Tests that every code block on the pages runs or, if this takes too long for a test, that its
names exist.

Python runs here (`RUN`) or in a separate test of its output (`TESTED`). For two reports to MuJoCo
only the syntax is checked (`PARSED`). In shell lines every command, its options and their values
are parsed as by the command line; the blocks in `SHELL` run whole.
"""

import argparse
import ast
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from mjtactile.cli import build_parser
from mjtactile.commands import COMMANDS
from mjtactile.core import resources
from mjtactile.core.design import load_sensor
from mjtactile.rig.file import load_sim_rig
from tests.fake_run import write_fake_recording

CHECKOUT = Path(__file__).resolve().parents[2]
PAGES = [
    CHECKOUT / "README.md",
    CHECKOUT / "CONTRIBUTING.md",
    *sorted((CHECKOUT / "docs").rglob("*.md")),
]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
INDENTED = re.compile(r"(?:^    [^\n]*\n)+", re.MULTILINE)
INLINE = re.compile(r"`(mjtactile [a-z][a-z-]*[^`\n]*)`")

TESTED = {
    ("README.md", 0): "test_docs.py::test_attach_example_of_the_readme",
    ("docs/tutorials/scene.md", 0): "test_docs.py::test_example_of_touch_in_your_scene",
    ("docs/how-to/controllers.md", 0): "test_docs.py::test_controller_example",
    ("docs/how-to/controllers.md", 1): "test_docs.py::test_slip_controller_example",
    ("docs/tutorials/controller.md", 0): "test_docs.py::test_controller_of_the_tutorial",
    (
        "docs/how-to/studio.md",
        0,
    ): "studio/test_user_scene.py::test_the_documented_loop_accepts_local_connections_only",
    (
        "docs/how-to/integrations.md",
        0,
    ): "../integrations/test_mjlab.py::test_a_gripper_of_mjlab_closes_on_an_egg_by_touch",
    ("docs/how-to/many_worlds.md", 0): "../many_worlds/test_example.py::test_eggs_are_lifted",
    (
        "docs/how-to/many_worlds.md",
        1,
    ): "../many_worlds/test_grasps.py::test_randomized_grasps_follow_the_environment_on_the_cpu",
    (
        "docs/tutorials/policy.md",
        0,
    ): "../examples/test_policy_tutorial.py::test_the_tutorial_fits_the_recorded_actions",
    ("docs/how-to/train.md", 0): "gym/test_grasp_env.py::test_the_example_of_the_page",
    (
        "docs/how-to/train.md",
        1,
    ): "../examples/test_learn_to_grasp.py::test_the_ten_lines_of_the_page_learn",
}
PARSED = {
    ("docs/decisions/upstream/first-solve-has-no-tolerance-of-its-own.md", 0),
    ("docs/decisions/upstream/tendon-exactly-at-rest.md", 0),
}
SHELL = {
    ("docs/tutorials/sensor.md", 0),
    ("docs/tutorials/sensor.md", 1),
    ("docs/tutorials/gripper.md", 0),
    ("docs/tutorials/gripper.md", 1),
    ("docs/tutorials/controller.md", 0),
    ("docs/tutorials/controller.md", 1),
}
"""Code blocks in their order; blocks of a page share a folder."""
TOOLS = ("sed", "pip", "make", "python", "pytest", "ssh")
"""Programs other than mjtactile that a line may call."""


def name_of(page):
    return page.relative_to(CHECKOUT).as_posix()


def fenced(*languages):
    """Yield page, index among its blocks of these languages, text."""
    return [
        (name_of(page), number, text)
        for page in PAGES
        for number, text in enumerate(
            text for language, text in FENCE.findall(page.read_text()) if language in languages
        )
    ]


def shell_lines():
    """Yield page and line of fenced and indented blocks, with continued lines joined."""
    for page in PAGES:
        text = page.read_text()
        blocks = [block for language, block in FENCE.findall(text) if language in ("bash", "sh")]
        blocks += [
            re.sub(r"(?m)^ {4}", "", block) for block in INDENTED.findall(FENCE.sub("", text))
        ]
        for line in "\n".join(blocks).replace("\\\n", " ").splitlines():
            if re.match(rf"(mjtactile|{'|'.join(TOOLS)}) \S", line):
                yield name_of(page), line


PYTHON = fenced("python")
LINES = sorted(set(shell_lines()))


def names(rows):
    return [f"{page}:{number}" for page, number, *_ in rows]


def test_the_tables_name_existing_commands():
    there = {(page, number) for page, number, _ in PYTHON}
    assert set(TESTED) | PARSED <= there
    assert {(page, number) for page, number, _ in fenced("bash", "sh")} >= SHELL
    for test in TESTED.values():
        file, _, function = test.partition("::")
        assert f"def {function}(" in (Path(__file__).parent / file).read_text()
    assert len(LINES) > 40


RUN = [row for row in PYTHON if row[:2] not in TESTED and row[:2] not in PARSED]


@pytest.mark.parametrize(("page", "number", "text"), RUN, ids=names(RUN))
def test_python_blocks_run(page, number, text, tmp_path, monkeypatch):
    write_fake_recording(tmp_path / "runs" / "grasp" / "recording", count=5)
    monkeypatch.chdir(tmp_path)
    exec(compile(text, page, "exec"), {"__name__": "__main__"})


PARSED_ROWS = [row for row in PYTHON if row[:2] in PARSED]


@pytest.mark.parametrize(("page", "number", "text"), PARSED_ROWS, ids=names(PARSED_ROWS))
def test_python_blocks_parse(page, number, text):
    ast.parse(text, page)


def options_of(words):
    """Return every option of the command at the start of `words`."""
    parser = build_parser(words[0])
    found = set()
    while parser is not None:
        found |= set(parser._option_string_actions)
        chosen = next(
            (
                action.choices
                for action in parser._actions
                if isinstance(action, argparse._SubParsersAction)
            ),
            {},
        )
        parser = next((chosen[word] for word in words if word in chosen), None)
    return found


@pytest.mark.parametrize(("page", "line"), LINES, ids=lambda value: value[:70])
def test_a_shell_line_names_existing_commands(page, line, monkeypatch, tmp_path):
    words = shlex.split(line, comments=True)
    words = words[: words.index("&&")] if "&&" in words else words
    if words[0] == "mjtactile":
        monkeypatch.chdir(tmp_path)
        try:
            build_parser(words[1]).parse_args(words[1:])
        except SystemExit as end:  # --help
            assert end.code == 0 and "--help" in words
    elif words[0] == "make":
        assert re.search(rf"(?m)^{words[1]}:", (CHECKOUT / "Makefile").read_text())
    elif words[:2] == ["pip", "install"]:
        extras = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["project"][
            "optional-dependencies"
        ]
        assert all(extra in extras for extra in re.findall(r"mjtactile\[(\w+)\]", line))


@pytest.mark.parametrize(
    "page", [page for page in PAGES if page.parent.name != "decisions"], ids=name_of
)
def test_options_in_the_text_exist(page):
    for text in INLINE.findall(page.read_text()):
        words = text.removeprefix("mjtactile ").replace("=", " ").split()
        assert words[0] in COMMANDS, text
        assert {word.rstrip(",.") for word in words if word.startswith("--")} <= options_of(
            words
        ), text


@pytest.mark.parametrize("page", sorted({page for page, _ in SHELL}))
def test_shell_blocks_run(page, tmp_path):
    command = f'mjtactile() {{ {shlex.quote(sys.executable)} -m mjtactile "$@"; }}\nset -e\n'
    for number in sorted(number for there, number in SHELL if there == page):
        text = next(
            text for there, which, text in fenced("bash", "sh") if (there, which) == (page, number)
        )
        subprocess.run(
            ["bash", "-c", command + text],
            cwd=tmp_path,
            check=True,
            capture_output=True,
            timeout=300,
        )
    if page.endswith("sensor.md"):  # the changed file is a sensor with the new values
        design = load_sensor(tmp_path / "my_sensor.toml")
        assert (design.markers.count, design.membrane.thickness, design.chamber.supply_gauge) == (
            49,
            0.4e-3,
            1500.0,
        )
    if page.endswith("gripper.md"):
        assert load_sim_rig(tmp_path / "my_hand.toml").gripper.opening[1] == 0.1
    if page.endswith("controller.md"):
        assert (tmp_path / "firm.py").read_text() != resources.find(
            "gentle", "controllers", ".py"
        ).read_text()
