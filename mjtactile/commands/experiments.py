"""`mjtactile experiments`: repeat the paper's Results, as figures and one table."""

from __future__ import annotations

import argparse
from pathlib import Path

from mjtactile import InputError
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import optional_folder, print_result, stdout_to_stderr
from mjtactile.commands.repository_only import of_checkout
from mjtactile.recording.files import write_json
from mjtactile.runtime.progress import Progress

DESCRIPTION = """\
Repeat the Results of the paper in simulation, from images alone:
  fig5a  load cell against estimate, 1 mm increments, cylinder; ours and dF = c dA
  fig5b  solid cylinder and sponge: line and parabola through force against deformation
  fig5c  force over time while driving in
  fig6   15 images of 16 circles: error of the centers
  fig7   three objects: image, reconstruction, force field
  air    sensitivity set by pressure and amount of air"""
EPILOG = """\
examples:
  mjtactile experiments --out runs/paper
  mjtactile experiments --only fig6,air --json
  mjtactile experiments --page docs/validation/paper.md
      writes the documentation page with its figures
"""
NAMES = ("fig5a", "fig5b", "fig5c", "fig6", "fig7", "air")


def _names(text: str) -> list[str]:
    names = text.split(",")
    wrong = [name for name in names if name not in NAMES]
    if wrong:
        raise argparse.ArgumentTypeError(f"{wrong[0]!r} is not one of {', '.join(NAMES)}")
    return names


ARGUMENTS = (
    arg.option("--only NAME,…", f"which (default: {','.join(NAMES)})", list(NAMES), type=_names),
    arg.flag("--quick", "use fewer points, as a quick check"),
    arg.out("folder for experiments.json, experiments.md and one figure per experiment"),
    arg.option(
        "--page FILE.md",
        "also write a Markdown page; figures in images/experiments/, next to the page or above it",
        type=Path,
    ),
)


def _images(page: Path) -> str:
    """Return the folder of the figures, relative to the page: that above the page if it exists."""
    above = (page.parent / ".." / "images").is_dir()
    return "../images/experiments" if above else "images/experiments"


def run(options: argparse.Namespace) -> int:
    if options.page is not None and options.page.suffix != ".md":
        raise InputError("the file is not a Markdown file", source=options.page, field="--page")
    page_images = None if options.page is None else options.page.parent / _images(options.page)
    with (
        optional_folder(options.out, "experiments.json", "experiments.md") as out,
        optional_folder(page_images) as images,
        stdout_to_stderr(),
    ):
        figures = of_checkout("paper.figures")
        findings = of_checkout("paper.results_table")
        experiments = of_checkout("paper.run")

        results = experiments.run(
            options.only, out, quick=options.quick, notify=Progress(quiet=options.json).message
        )
        if out is not None:
            write_json(out / "experiments.json", experiments.without_arrays(results))
            (out / "experiments.md").write_text(findings.table(results), encoding="utf-8")
        if images is not None and options.page is not None:
            for name, result in results.items():
                figures.save(name, result, images)
            Path(options.page).write_text(
                findings.page(results, _images(options.page)), encoding="utf-8"
            )
    print_result(
        options,
        experiments.without_arrays(results),
        findings.table(results) + ((f"\nfigures were written to {out}") if out is not None else ""),
    )
    return 0
