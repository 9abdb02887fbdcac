"""`mjtactile docs`: the pages of the documentation, wherever the package is installed."""

from __future__ import annotations

import argparse
from pathlib import Path

from mjtactile import InputError
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import print_json
from mjtactile.core import resources

SIMULATES = False
DESCRIPTION = """\
List the pages of the documentation with the folder that they are in, or print one of them.
They come with the package; pictures and links work in that folder."""
EPILOG = """\
examples:
  mjtactile docs
  mjtactile docs sensors | less
  mjtactile docs tutorials/sensor
"""

ARGUMENTS = (arg.positional("page", "PAGE", "print this page", nargs="?"),)


def run(options: argparse.Namespace) -> int:
    folder = resources.folder("docs")
    pages = {
        path.relative_to(folder).with_suffix("").as_posix(): path
        for path in sorted([*folder.glob("*.md"), *folder.glob("tutorials/*.md")])
    }
    if options.page is None:
        titles = {name: _title(path) for name, path in pages.items()}
        if options.json:
            print_json({"folder": folder, "pages": titles})
        else:
            print(
                f"in {folder}:",
                *(f"  {name:<21} {title}" for name, title in titles.items()),
                sep="\n",
            )
        return 0
    name = options.page.removeprefix("docs/").removesuffix(".md")
    if name not in pages:
        raise InputError("no such page", source=options.page, choices=pages)
    text = pages[name].read_text(encoding="utf-8")
    if options.json:
        print_json({"page": pages[name], "text": text})
    else:
        print(text, end="")
    return 0


def _title(path: Path) -> str:
    with path.open(encoding="utf-8") as lines:
        return next(lines).removeprefix("#").strip()
