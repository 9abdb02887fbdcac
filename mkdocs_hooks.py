"""What `make docs` adds to the pages in docs/: the README as the start, the decisions, the
changelog, files that pages link to, the front door's API, and the page of a grasp beside the
gallery. Links that leave docs/ are led to these."""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

import mjtactile

ROOT = Path(__file__).parent
GRASP = ROOT / "build" / "docs" / "egg" / "summary.html"
"""The page of a grasp, which `make docs` makes before."""
LINK = re.compile(r"(\]\()(?!https?:|#|data:)([^)#\s]+)(#[^)\s]*)?(\))")
TOP_LEVEL = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
"""Pages beside docs/, and where they are in the site."""
MATH = re.compile(r"(```.*?```|`[^`\n]*`)|\$\$(.+?)\$\$|\$([^\s$](?:[^$\n]*[^\s$])?)\$", re.DOTALL)
"""Code, which stays as it is; a displayed equation; an equation in the text."""
_FENCE = "````"
_LANGUAGES = {".py": "python", ".toml": "toml", ".xml": "xml"}
_DOORS = {
    "Touch in a MuJoCo scene": ("sim.attach", "plugin.attach", "plugin.sim_finger"),
    "Scenarios": ("core.scenario", "rig.scenario"),
    "Rigs and sessions": (
        "rig.finger",
        "rig.registry",
        "core.scaled_clock",
        "rig.file",
        "runtime.session",
        "runtime.controller",
    ),
    "Observations, touch and commands": (
        "core.types.control",
        "core.types.command",
        "core.types.touch",
        "core.types.contact_shape",
        "core.types.devices",
        "core.types.vision",
    ),
    "Sensing": (
        "sensing.pipeline",
        "sensing.stateful_pipeline",
        "sensing.pose.circles_from_images",
        "sensing.pose.dot_tracking",
        "sensing.force.from_surface",
        "core.optics",
    ),
    "Sensors and their calibration": ("core.design", "core.calibration", "core.calibration_parts"),
    "Quasi-static membrane": (
        "quasistatic.membrane",
        "quasistatic.obstacles",
        "quasistatic.sensitivities",
        "quasistatic.solution",
    ),
    "Recordings": (
        "recording.reader",
        "recording.writer",
        "recording.observer",
        "export.live_view",
        "export.effective_camera",
    ),
    "Policies": ("core.policy", "core.policy_file", "recording.policy_data"),
    "Errors": ("core.errors",),
}
"""Headings of the API's page, and the modules whose public names stand below each."""


def pages() -> dict[str, str]:
    """Pages that are no files in docs/: their address in the site, and their text."""
    decisions = sorted((ROOT / "docs" / "decisions").glob("*.md"))
    made = {
        **{
            address: _moved((ROOT / name).read_text("utf-8"), "", address)
            for name, address in TOP_LEVEL.items()
        },
        "decisions/index.md": "# Decisions\n\n"
        + "\n".join(f"- [{_title(path)}]({path.name})" for path in decisions)
        + "\n",
        **_api(),
    }
    for path in linked_files():
        made[f"files/{path}.md"] = (
            f"# {path}\n\n{_FENCE}{_LANGUAGES.get(Path(path).suffix, '')}\n"
            f"{(ROOT / path).read_text('utf-8')}{_FENCE}\n"
        )
    return made


def linked_files() -> list[str]:
    """Files outside of docs/ that the pages, README and changelog link to."""
    found = set()
    top = [ROOT / name for name in TOP_LEVEL]
    for page in (*top, *(ROOT / "docs").rglob("*.md")):
        for target in (match[2] for match in LINK.finditer(page.read_text("utf-8"))):
            path = (page.parent / target).resolve().relative_to(ROOT)
            if path.as_posix() in TOP_LEVEL:
                continue
            if path.parts[0] != "docs" and (ROOT / path).is_file():
                found.add(path.as_posix())
    return sorted(found)


def _title(path: Path) -> str:
    return path.read_text("utf-8").splitlines()[0].removeprefix("# ")


def _moved(text: str, folder: str, page: str) -> str:
    """The `text` of a file in `folder` of the repository, its links as they must be on the `page`
    of the site."""

    def lead(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(folder, match[2]))
        inside = posixpath.relpath(_address(target), posixpath.dirname(page) or ".")
        return f"{match[1]}{inside}{match[3] or ''}{match[4]}"

    text = LINK.sub(lead, text).replace("<details>", '<details markdown="1">')
    # Markdown's tables want an empty line before them
    return re.sub(r"(?m)^(<!-- .* -->)$", r"\n\1\n", text)


def _address(target: str) -> str:
    """Where a file of the repository is in the site."""
    if target == "docs/decisions":
        return "decisions/index.md"
    if target in TOP_LEVEL:
        return TOP_LEVEL[target]
    if target.startswith("docs/"):
        return target.removeprefix("docs/")
    return f"files/{target}.md"


def _api() -> dict[str, str]:
    """Return the pages of the API: one for each heading of `_DOORS`, and an index."""
    homes: dict[str, list[str]] = {}
    for name in mjtactile.__all__:
        homes.setdefault(mjtactile._HOME[name].removeprefix("mjtactile."), []).append(name)
    if left := set(homes) - {module for modules in _DOORS.values() for module in modules}:
        raise ValueError(f"mkdocs_hooks.py: no heading for {sorted(left)}")
    index = ["# Python API\n\n`import mjtactile` provides all public names.\n"]
    made = {}
    for heading, modules in _DOORS.items():
        address = f"{heading.lower().replace(' ', '_').replace(',', '')}.md"
        names = [name for module in modules for name in homes.get(module, ())]
        blocks = [f"::: mjtactile.{name}" for name in names]
        made[f"api/{address}"] = f"# {heading}\n\n" + "\n\n".join(blocks) + "\n"
        listed = ", ".join(f"`{name}`" for name in names)
        index.append(f"- [{heading}]({address}): {listed}")
    return made | {"api/index.md": "\n".join(index) + "\n"}


def typeset(markdown: str) -> tuple[str, list[str]]:
    """Replace LaTeX by marks and return the text and the MathML of each mark.

    Markdown would read parts of an equation as markup, so equations are inserted at the end.
    """
    from latex2mathml.converter import convert  # pyright: ignore[reportMissingImports]

    made: list[str] = []

    def mark(match: re.Match[str]) -> str:
        code, display, inline = match.groups()
        if code is not None:
            return code
        kind = "block" if display else "inline"
        made.append(convert((display or inline).strip(), display=kind))
        text = f"mathml{len(made) - 1}end"
        return f"\n\n{text}\n\n" if display and "\n|" not in match[0] else text

    return MATH.sub(mark, markdown), made


# -- MkDocs calls these -----------------------------------------------------------------


def on_files(files: Any, config: Any) -> Any:
    from mkdocs.structure.files import File  # pyright: ignore[reportMissingImports]

    for address, text in pages().items():
        files.append(File.generated(config, address, content=text))
    if GRASP.is_file():
        files.append(File.generated(config, "egg.html", abs_src_path=str(GRASP)))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    address = page.file.src_uri
    markdown, page.meta["equations"] = typeset(markdown)
    if page.file.generated_by:
        return markdown
    if address == "about/gallery.md" and GRASP.is_file():
        markdown += (
            "\n## A grasp to turn and zoom\n\n[The page that `mjtactile grasp` writes beside "
            "its recording](../egg.html).\n"
        )
    return _moved(markdown, posixpath.join("docs", posixpath.dirname(address)), address)


def on_post_page(output: str, page: Any, config: Any) -> str:
    equations = page.meta.get("equations", [])
    return re.sub(r"mathml(\d+)end", lambda match: equations[int(match[1])], output)
