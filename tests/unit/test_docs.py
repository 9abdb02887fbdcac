"""Tests that the content of the documents works: the README's scene, the object and the controller
to copy, the links."""

import re
import tomllib
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

import mjtactile
import mkdocs_hooks
from benchmarks import benchmark_index, readme_table
from mjtactile.commands import COMMANDS
from mjtactile.commands.bench import BENCHMARKS
from mjtactile.commands.output import page_of_table
from mjtactile.core.config_fields import SectionEntry, default_of, entries
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.field_types import LensCoefficients, Number, Text
from mjtactile.core.types import Command, GripperState, Observation, Slip, Touch, ValveState
from mjtactile.recording.log_schema import SENSED, TRUE
from mjtactile.runtime.controller import load_controller
from mjtactile.sim.effects.catalog import EFFECTS
from mjtactile.sim.scenes.objects import load_object
from tools import architecture

CHECKOUT = Path(__file__).resolve().parents[2]
WHEEL = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["tool"]["hatch"]["build"][
    "targets"
]["wheel"]
PAGES = [
    CHECKOUT / "README.md",
    CHECKOUT / "CONTRIBUTING.md",
    CHECKOUT / "CHANGELOG.md",
    *sorted((CHECKOUT / "docs").rglob("*.md")),
]


def found(pattern: str, text: str) -> str:
    """Return the first group of the match."""
    match = re.search(pattern, text, re.DOTALL | re.MULTILINE)
    assert match is not None, pattern
    return match.group(1)


def block(page: str, language: str, number: int = 0) -> str:
    return re.findall(rf"```{language}\n(.*?)```", (CHECKOUT / page).read_text(), re.DOTALL)[number]


def test_attach_example_of_the_readme():
    names: dict = {}
    exec(block("README.md", "python"), names)
    # the weight that lies on it
    assert names["finger"].touch.force_normal == pytest.approx(0.05 * 9.81, abs=0.03)


def test_example_of_touch_in_your_scene(capsys):
    names: dict = {}
    exec(block("docs/tutorials/scene.md", "python"), names)
    # the weight that lies on it
    assert names["finger"].touch.force_normal == pytest.approx(0.05 * 9.81, abs=0.03)
    assert "option.integrator: Euler -> discrete" in capsys.readouterr().out


def test_object_example(tmp_path):
    (tmp_path / "plum.xml").write_text(block("docs/reference/object_files.md", "xml"))
    plum = load_object(tmp_path / "plum.xml")
    assert plum.break_force == 2.0 and plum.material == "soft" and plum.grasp_height == 0.02


def test_controller_example(tmp_path):
    (tmp_path / "mine.py").write_text(block("docs/how-to/controllers.md", "python"))
    controller = load_controller(tmp_path / "mine.py")

    def observe(force):
        touch = Touch(1.0, 0.0, force, 0.01, force > 0.05)
        state = GripperState(0.05, 0, 0, 0)
        valves = (ValveState(False), ValveState(False))
        return Observation(1.0, 1 / 30, (touch, touch), state, valves, Command(0.05, 3.0))

    assert controller.step(observe(0.0)).opening == pytest.approx(0.05 - 0.01 / 30)
    assert controller.step(observe(0.4)).phase == "done"


def test_slip_controller_example(tmp_path):
    (tmp_path / "mine.py").write_text(block("docs/how-to/controllers.md", "python", 1))
    controller = load_controller(tmp_path / "mine.py")
    state = GripperState(0.05, 0, 0, 0)
    valves = (ValveState(False),) * 2
    touch = Touch(1.0, 0.01, 0.25, 0.01, True)
    slips = replace(touch, slip=Slip("incipient", np.zeros(2), 0.0, 0.4))

    def step(*touches):
        return controller.step(Observation(1.0, 1 / 30, touches, state, valves, Command(0.05, 3.0)))

    assert step(touch, touch).opening == 0.05 and step(touch, touch).memory["target"] == 0.2
    assert step(touch, slips).opening < 0.05 and step(touch, slips).memory[
        "target"
    ] == pytest.approx(0.3)
    assert step(touch, replace(slips, age=0.2)).opening == 0.05
    assert step(touch, replace(touch, force_normal=np.nan)).opening == 0.05


def test_controller_of_the_tutorial(tmp_path):
    (tmp_path / "mine.py").write_text(block("docs/tutorials/controller.md", "python"))
    controller = load_controller(tmp_path / "mine.py")
    state = GripperState(0.05, 0, 0, 0)
    valves = (ValveState(False),) * 2
    command = Command(0.05, 3.0)
    openings = []
    phases = []
    for k in range(40):  # contact from 0.3 s on
        touch = Touch(k / 30, 0.0, 0.4 * (k > 9), 0.01, k > 9)
        command = controller.step(
            Observation(k / 30, 1 / 30, (touch, touch), state, valves, command)
        )
        openings.append(command.opening)
        phases.append(command.phase)
        if command.phase == "done":
            break
    # half a second is 15 cycles, and the first
    assert phases == ["close"] * 10 + ["hold"] * 16 + ["done"]
    assert openings[9] == pytest.approx(0.05 - 10 * 0.01 / 30) and openings[-1] == pytest.approx(
        openings[9] + 0.01
    )


def test_the_page_of_controllers_has_every_field_of_touch():
    page = (CHECKOUT / "docs/how-to/controllers.md").read_text()
    table = found(r"What a `Touch` holds.*?\n\n(.*?)\n\n", page)
    firsts = {
        name
        for line in table.splitlines()[2:]
        for name in re.findall(r"`(\w+)`", line.split("|")[1])
    }
    assert firsts | {"status"} == {field.name for field in fields(Touch)}


@pytest.mark.parametrize(
    ("heading", "columns"),
    [
        ("| `images` |", {"images": ("", "")} | dict(SENSED)),
        ("| `force_normal_true` |", dict(TRUE)),
    ],
)
def test_the_page_of_recordings_has_every_column(heading, columns):
    page = (CHECKOUT / "docs/reference/recording_format.md").read_text()
    lines = page[page.index(heading) :].split("\n\n")[0].splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert [row[0].strip("`") for row in rows] == list(columns)
    for key, unit, meaning in rows[1:]:
        assert (unit, meaning) == columns[key.strip("`")][:2]


def anchors(page):
    """Return the valid link anchors of the page: its headings, as GitHub and the site write
    them."""
    text = re.sub(r"(?s)^```.*?^```$", "", page.read_text(), flags=re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        for heading in re.findall(r"(?m)^#+ (.*)$", text)
    }


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_have_existing_targets(page):
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#]*)#?([^)]*)\)", page.read_text()):
        path = page.parent / target if target else page
        assert path.exists(), target
        assert not anchor or anchor in anchors(path), f"{target}#{anchor}"


def test_the_gallery_shows_every_figure_of_the_pages():
    shown = set(
        re.findall(r"\]\(\.\./(images/[^)]+)\)", (CHECKOUT / "docs/about/gallery.md").read_text())
    )
    there = {
        path.relative_to(CHECKOUT / "docs").as_posix()
        for path in (CHECKOUT / "docs/images").rglob("*.*")
    }
    assert there - shown == {"images/shadows.png"}  # which no command draws


def test_the_figure_of_the_architecture_is_that_of_the_import_contracts():
    sampled = architecture.render((CHECKOUT / "pyproject.toml").read_text())
    # else: .venv/bin/python tools/architecture.py
    assert architecture.FIGURE.read_text() == sampled
    contracts = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = next(
        contract["layers"] for contract in contracts["contracts"] if contract["name"] == "Layers"
    )
    rooms = {room for floor in architecture.floors(layers) for room in floor.rooms}
    # if it fails: describe the purpose of the room in a few words
    assert rooms <= set(architecture.ROOMS)


def test_the_figure_reads_layers_as_import_linter_does():
    layers = ["cli", "(sim) | sensing", "types : (rig)"]
    assert architecture.floors(layers) == [
        architecture.Floor(("cli",), is_separate=False),
        architecture.Floor(("sim", "sensing"), is_separate=True),
        architecture.Floor(("types", "rig"), is_separate=False),
    ]


PLACES = r"mjtactile|models|controllers|examples|benchmarks|tests|docs|tools|firmware"
ROOMS = r"core|kernels|sensing|sim|rig|run|devices"


@pytest.mark.parametrize(
    "page", [page for page in PAGES if "decisions" not in page.parts], ids=lambda page: page.name
)
def test_files_named_on_a_page_exist(page):
    """Files that a page mentions exist, except on decision pages, which state the past."""
    paths = re.findall(rf"`((?:{PLACES}|{ROOMS})/[\w./-]*\.\w+)`", page.read_text())
    there = [CHECKOUT / path for path in paths if "NAME" not in path]
    inside = [CHECKOUT / "mjtactile" / path for path in paths if "NAME" not in path]
    gone = [a for a, b in zip(there, inside, strict=True) if not a.exists() and not b.exists()]
    assert gone == []


def test_tables_named_in_contributing_exist():
    text = (CHECKOUT / "CONTRIBUTING.md").read_text()
    assert len(re.findall(rf"`(?:{PLACES})/[\w./-]*`", text)) > 40
    for table, file in re.findall(r"`([A-Z_]{5,})` in `(mjtactile/[\w/.]+)`", text):
        assert re.search(rf"(?m)^{table}\b", (CHECKOUT / file).read_text()), table


def test_the_page_of_effects_has_every_effect():
    rows = (
        (CHECKOUT / "docs/reference/effects.md")
        .read_text()
        .split("|---|---|---|\n")[1]
        .split("\n\n")[0]
    )
    named = {name.strip() for row in rows.splitlines() for name in row.split("|")[1].split(",")}
    assert named == {entry.name for entry in EFFECTS}


def test_the_page_of_commands_has_each_with_an_example():
    page = (CHECKOUT / "docs/reference/commands.md").read_text()
    assert set(re.findall(r"(?m)^    mjtactile ([\w-]+)", page)) == set(COMMANDS)


def test_the_site_has_readme_decisions_and_public_names():
    """The site has the README, the decisions and the whole public API.

    `make docs` adds them to the pages, and reports itself if they build with a warning.
    """
    pages = mkdocs_hooks.pages()
    assert (
        "](tutorials/scene.md)" in pages["index.md"] and "](images/grasp.webp)" in pages["index.md"]
    )
    assert (
        "](decisions/index.md)" in pages["index.md"]
        and "](0013-contact-points.md)" in pages["decisions/index.md"]
    )
    api = "\n".join(text for address, text in pages.items() if address.startswith("api/"))
    assert set(re.findall(r"(?m)^::: mjtactile\.(\w+)$", api)) == set(mjtactile.__all__)
    assert "](images/architecture.svg)" in pages["contributing.md"]
    assert "](contributing.md)" in pages["index.md"]
    assert "def step(observation" in pages["files/controllers/slip_aware.py.md"]


def test_every_page_is_in_the_navigation_or_linked_from_a_page_that_is():
    docs = CHECKOUT / "docs"
    nav = (CHECKOUT / "mkdocs.yml").read_text().partition("\nnav:")[2]
    listed = set(re.findall(r"(\S+\.md)", nav))
    generated = {"index.md", "contributing.md", "api/index.md"}
    there = {
        path.relative_to(docs).as_posix()
        for path in docs.rglob("*.md")
        if path.parent.name not in ("decisions", "upstream")
    }
    assert listed <= there | generated
    linked = {
        (docs / page).parent.joinpath(target).resolve()
        for page in listed - generated
        for target in re.findall(r"\]\((?!https?:)([^)#]+\.md)", (docs / page).read_text())
    }
    assert {page for page in there - listed if (docs / page).resolve() not in linked} == set()


@pytest.mark.parametrize(
    "page", sorted((CHECKOUT / "docs").rglob("*.md")), ids=lambda page: page.name
)
def test_links_of_the_pages_in_the_wheel_stay_in_the_wheel(page):
    """`mjtactile docs` shows where the pages are: links work there, too."""
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text()):
        assert (page.parent / target).resolve().relative_to(CHECKOUT).parts[0] in WHEEL[
            "force-include"
        ], target


@pytest.mark.parametrize(
    ("page", "block", "benchmark", "table"),
    [
        ("README.md", "readme-table", readme_table, readme_table.table),
        (
            "docs/validation/benchmarks.md",
            "benchmark-index",
            benchmark_index,
            benchmark_index.table,
        ),
    ],
)
def test_quoted_results_equal_the_benchmark_pages(page, block, benchmark, table):
    text = (CHECKOUT / page).read_text()
    written = found(rf"<!-- bench:{block} -->\n(.*?)<!-- /bench -->", text)
    # else: mjtactile bench BLOCK --readme
    assert written.strip() == table(benchmark.run(Path())).strip()
    assert page_of_table(block) == CHECKOUT / page


def test_the_index_of_benchmarks_has_every_page_and_each_page_its_sections():
    pages = {page.stem: page for page in (CHECKOUT / "docs/validation/benchmarks").glob("*.md")}
    indexed = {entry.page for entry in benchmark_index.ENTRIES}
    assert {f"benchmarks/{name}" for name in pages} <= indexed
    assert set(pages) <= set(BENCHMARKS)
    for name, page in pages.items():
        text = page.read_text()
        assert page_of_table(name) == page
        order = ["**Question.**", "**Setup.**", f"<!-- bench:{name} -->", "**Reproduce:**"]
        places = [text.index(part) for part in order]
        assert places == sorted(places)
        assert f"`mjtactile bench {name} --readme`" in text


def test_the_readme_has_five_results_in_150_lines():
    readme = (CHECKOUT / "README.md").read_text()
    assert sum(number.headline for number in readme_table.NUMBERS) == 5
    assert len(readme.splitlines()) <= 150
    # three commands and the results precede all sections
    assert readme.index("bench:readme-table") < readme.index("\n## ")


GENERATED = re.compile(r"(?s)<!-- bench:.*?<!-- /bench -->")
REPORTED_ONCE = {
    # pattern of a sentence with the number: the row of the table of numbers that it must match
    r"([\d.]+)\s*(?:x|times|of)\s+(?:the\s+)?(?:real[ -]time|clock)": "speed of a complete grasp",
    r"(\d+ of \d+) grasps": "grasps held",
    r"(\d+ of \d+)(?: injected)? faults": "faults of the emulated rig",
    r"false alarms in (\d+ %) of holds": "holds with a false slip alarm",
    r"detected in time in (\d+ %) of all cases": "slips detected before 0.5 mm",
}


@pytest.mark.parametrize(
    ("reported", "quantity"), REPORTED_ONCE.items(), ids=REPORTED_ONCE.values()
)
def test_no_page_contradicts_a_quoted_result(reported, quantity):
    """No sentence states a number other than the measured one; tables come from benchmarks and name
    their measurement."""
    rows = readme_table.run(Path())["numbers"]
    (value,) = [row["value"] for row in rows if row["quantity"].startswith(quantity)]
    others = [
        (page.name, found)
        for page in PAGES
        if "decisions" not in page.parts and page.name != "CHANGELOG.md"
        for found in re.findall(reported, GENERATED.sub("", page.read_text()))
        if not value.startswith(found)
    ]
    assert others == []


def test_the_readmes_short_list_of_limits_has_the_numbers_of_the_page():
    readme = (CHECKOUT / "README.md").read_text()
    section = found(r"\n## Honest limits\n(.*?)\n## ", readme)
    number = r"\d[\d.-]* (?:%|mm|times)"
    page = (CHECKOUT / "docs/validation/limitations.md").read_text()
    assert set(re.findall(number, section)) <= set(re.findall(number, page))


def test_only_the_page_of_speed_has_tables_of_real_time_factors():
    """Only the listed pages have tables of real-time factors.

    The speed of a grasp next to other work is not comparable to the one measured alone.
    """
    having = {
        page.relative_to(CHECKOUT).as_posix()
        for page in PAGES
        for line in page.read_text().splitlines()
        if line.startswith("|") and "x real time" in line
    }
    assert having == {"README.md", "docs/validation/accuracy.md"}


def test_a_number_that_a_page_lacks_is_named():
    page = (
        "| what | dense |\n|---|---|\n| force | 1 |\n\n| what | paper16 |\n|---|---|\n| force "
        "| 2 |\n"
    )
    # of the table that has the column
    assert readme_table.cell(page, "for", "paper16", source="x") == "2"
    page += "\n| what | dense |\n|---|---|\n| force | 3 |\n| shear | 4 |\n"
    assert readme_table.cell(page, "force", "dense", source="x") == "1"
    # both of one table
    assert readme_table.cell(page, "force | / shear", "dense", source="x") == "3 / 4"
    with pytest.raises(InputError, match=r"x\.md.*'torque'"):
        readme_table.cell(page, "torque", "dense", source="x")


SECTIONS = [
    name for name, entry in entries(SensorDesign).items() if isinstance(entry, SectionEntry)
]


@pytest.mark.parametrize("section", SECTIONS)
def test_the_page_of_sensor_files_has_every_field_with_its_range_and_default(section):
    text = found(
        rf"^## \[{section}\]$(.*?)^## ", (CHECKOUT / "docs/reference/sensor_files.md").read_text()
    )
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in text.splitlines()
        if line.startswith("| `")
    ]
    kind = entries(SensorDesign)[section].kind
    known = entries(kind)
    assert {row[0].strip("`") for row in rows} == {entry.key for entry in known.values()}
    by_key = {row[0].strip("`"): row[1:] for row in rows}
    special = {...: "required", float("inf"): "infinite", (): "of polygons"}
    for attribute, entry in known.items():
        allowed, if_left_out, meaning = by_key[entry.key]
        default = default_of(kind, attribute)
        if isinstance(entry, Number):
            is_integer = ", whole" if entry.integer else ""
            assert allowed == f"{entry.low:g} to {entry.high:g}{is_integer}", entry.key
        elif isinstance(entry, Text):
            assert allowed == " or ".join(f'`"{word}"`' for word in entry.choices or ()), entry.key
        else:
            assert allowed == "list of pairs", entry.key
        if isinstance(entry, LensCoefficients):
            reported = "no distortion"
        elif isinstance(default, str):
            reported = f'`"{default}"`'
        else:
            reported = special[default] if default in special else f"{default / entry.unit:g}"
        assert if_left_out == reported, entry.key
        assert meaning == entry.about, entry.key


def test_round_sensor_without_glass(tmp_path):
    dense = (CHECKOUT / "models/sensors/dense.toml").read_text()
    example = block("docs/reference/sensor_files.md", "toml")
    for section in ("frame", "glass"):
        new = found(rf"(\[{section}\].*?)(?=\n\n|\Z)", example)
        dense = re.sub(rf"\[{section}\].*?(?=\n\n)", new, dense, flags=re.DOTALL)
    (tmp_path / "round.toml").write_text(dense)
    design = load_sensor(tmp_path / "round.toml")
    assert design.frame.shape == "circle" and design.apparent_glass_thickness == 0.0
