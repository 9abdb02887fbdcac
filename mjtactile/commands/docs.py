"""`mjtactile docs`: the pages of the documentation, also of an installed package."""

from __future__ import annotations

import argparse
from pathlib import Path

from mjtactile import InputError
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import print_json
from mjtactile.core import resources

SIMULATES = False
DESCRIPTION = """\
List the documentation pages and their folder, or print one page. The pages come with the
package; images and links work in that folder."""
EPILOG = """\
examples:
  mjtactile docs
  mjtactile docs sensor_files | less
  mjtactile docs tutorials/sensor
"""
_LEFT_OUT = ("decisions", "upstream")
"""Folders whose pages are listed on the site only."""

ARGUMENTS = (arg.positional("page", "PAGE", "print this page", nargs="?"),)


def run(options: argparse.Namespace) -> int:
    folder = resources.folder("docs")
    pages = {
        path.relative_to(folder).with_suffix("").as_posix(): path
        for path in sorted(folder.rglob("*.md"))
        if path.parent.name not in _LEFT_OUT
    }
    if options.page is None:
        titles = {name: _title(path) for name, path in pages.items()}
        if options.json:
            print_json({"folder": folder, "pages": titles})
        else:
            print(
                f"in {folder}:",
                *(f"  {name:<34} {title}" for name, title in titles.items()),
                sep="\n",
            )
        return 0
    name = options.page.removeprefix("docs/").removesuffix(".md")
    matches = [page for page in pages if page == name or page.endswith(f"/{name}")]
    if len(matches) != 1:
        problem = "several pages have this name" if matches else "the page does not exist"
        raise InputError(problem, source=options.page, choices=matches or pages)
    name = matches[0]
    text = pages[name].read_text(encoding="utf-8")
    if options.json:
        print_json({"page": pages[name], "text": text})
    else:
        print(text, end="")
    return 0


def _title(path: Path) -> str:
    with path.open(encoding="utf-8") as lines:
        return next(lines).removeprefix("#").strip()
