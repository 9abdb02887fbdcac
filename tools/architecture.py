"""Diagram of the architecture, generated from the import contracts in pyproject.toml.

    python tools/architecture.py    # writes docs/images/architecture.svg

`make test` enforces the contracts, so the diagram cannot differ from the code. Only the one-line
description of each room (subpackage) is written here. A test fails if the diagram is outdated.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FIGURE = ROOT / "docs" / "images" / "architecture.svg"

ROOMS = {
    "cli": "the command line",
    "commands": "one module per command",
    "studio": "live view of a session",
    "explore": "whole objects by touch",
    "design_study": "predicted performance of sensor files",
    "sim_comparison": "run and simulation",
    "experiments": "the paper's figures",
    "evaluate": "many grasps, statistics",
    "gym": "Gymnasium",
    "warp": "thousands of worlds on one GPU",
    "fabrication": "drawings, CAD",
    "calibrate": "camera, force, valve",
    "plugin": "your own scene",
    "doctor": "checks of a rig",
    "fit": "identification",
    "export": "LeRobot, MCAP",
    "report": "images and pages of a run",
    "runtime": "control loop, supervisor, grasp, probe",
    "emulator": "emulated devices on ports",
    "replay": "a recording as a rig",
    "sim": "the MuJoCo backend",
    "devices": "drivers: camera, servos, valve",
    "sensing": "pixels to touch",
    "types": "inputs of a controller",
    "rig": "Protocols: fingers, gripper, lift",
    "recording": "writer and reader",
    "quasistatic": "a membrane over gas, on obstacles",
    "grasp_estimation": "weight and friction of a held object",
    "kernels": "loops in C",
    "core": "values, errors, geometry, optics, sensor designs",
}
"""Short descriptions of the package's rooms; an unlisted room has no line."""

INSIDE = ("Sensing layers", "Simulation layers", "Core layers")
"""Contracts of the rooms whose own order is shown at the side."""

COLOURS = {
    "cli commands studio": "#fde8cf",
    "explore study experiments evaluate gym make shadow": "#fdf6d8",
    "calibrate plugin doctor fit export report": "#fdf6d8",
    "runtime": "#fbd9d9",
    "sim devices emulator replay": "#d8e8fb",
    "sensing": "#dcf3dd",
}
"""Rooms to the fill of their boxes: doors, jobs, the loop, backends, sensing; the rest is grey."""
GREY = "#eceef1"

WIDTH = 1180
MARGIN = 20
SIDE = 350  # width of the panels at the right
FLOOR = 62  # height of a floor with the space below it
GAP = 10


@dataclass(frozen=True)
class Floor:
    """Rooms that stand side by side."""

    rooms: tuple[str, ...]
    is_separate: bool
    """True if the rooms may not import each other."""


def floors(layers: list[str]) -> list[Floor]:
    """Read the layers of a contract.

    Args:
        layers: Layers in import-linter's format, the top first. Names on one line are separated by
            "|" if they may not import each other and by ":" if they may. Brackets mark an optional
            module.

    Returns:
        The floors, the top first.
    """
    found = []
    for layer in layers:
        separator = "|" if "|" in layer else ":"
        names = [name.strip(" ()") for name in layer.split(separator)]
        found.append(Floor(tuple(names), separator == "|" and len(names) > 1))
    return found


def render(pyproject: str) -> str:
    """Render the contracts as SVG.

    Args:
        pyproject: The text of pyproject.toml.

    Returns:
        The figure as SVG text.
    """
    contracts = tomllib.loads(pyproject)["tool"]["importlinter"]["contracts"]
    layered = {contract["name"]: contract for contract in contracts if "layers" in contract}
    with_mujoco = _importers(contracts, "mujoco")
    house = floors(layered["Layers"]["layers"])
    top = 78
    left = WIDTH - SIDE - 3 * MARGIN
    parts = [
        _text(MARGIN, 30, "mjtactile: allowed imports", size=19, weight="bold"),
        _text(MARGIN, 54, "A package imports packages of lower rows only."),
    ]
    for k, floor in enumerate(house):
        parts += _row(floor, MARGIN, top + k * FLOOR, left, FLOOR - GAP, with_mujoco)
    bottom = top + len(house) * FLOOR
    parts += _legend(MARGIN, bottom + 14)
    y = top
    for name in INSIDE:
        panel, height = _panel(layered[name], WIDTH - SIDE - MARGIN, y)
        parts += panel
        y += height + 16
    height = max(bottom + 66, y + MARGIN)
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" '
            f'width="{WIDTH}" height="{height}" font-family="Helvetica, Arial, sans-serif">',
            f'<rect width="{WIDTH}" height="{height}" fill="white"/>',
            *parts,
            "</svg>\n",
        ]
    )


def _importers(contracts: list[dict], package: str) -> set[str]:
    """Return the rooms that may import an outside package.

    The contract forbids it to all others.
    """
    (contract,) = [
        contract
        for contract in contracts
        if contract.get("forbidden_modules") == [package] and "ignore_imports" in contract
    ]
    return {line.split(" -> ")[0].split(".")[1] for line in contract["ignore_imports"]}


def _row(
    floor: Floor, x: float, y: float, width: float, height: float, tagged: set[str]
) -> list[str]:
    """Render one floor: one box per room, joined if the rooms may import each other."""
    gap = GAP if floor.is_separate else 0
    each = (width - gap * (len(floor.rooms) - 1)) / len(floor.rooms)
    parts = []
    for k, room in enumerate(floor.rooms):
        corner = x + k * (each + gap)
        center = corner + each / 2
        parts.append(_box(corner, y, each, height, _colour(room)))
        parts.append(_text(center, y + 22, room, size=15, weight="bold", anchor="middle"))
        parts.append(_text(center, y + 40, ROOMS.get(room, ""), size=11.5, anchor="middle"))
        if room in tagged:
            parts.append(
                _text(corner + each - 6, y + 12, "mujoco", size=9.5, anchor="end", fill="#356")
            )
    return parts


def _panel(contract: dict, x: float, y: float) -> tuple[list[str], float]:
    """Render the order inside one room; return also the height of the panel."""
    (container,) = contract["containers"]
    room = container.removeprefix("mjtactile.")
    parts = []
    bottom = y + 30
    for floor in floors(contract["layers"]):
        lines = _lines(floor)
        height = 25 + 17 * (len(lines) - 1)
        parts.append(_box(x + 10, bottom, SIDE - 20, height, _colour(room)))
        for k, line in enumerate(lines):
            at = bottom + 17 * (k + 1)
            parts.append(_text(x + SIDE / 2, at, line, size=12, anchor="middle"))
        bottom += height + 5
    frame = _box(x, y, SIDE, bottom + 4 - y, "white")
    title = _text(x + 12, y + 22, f"inside {room}/", size=14, weight="bold")
    return [frame, title, *parts], bottom + 4 - y


def _lines(floor: Floor, longest: int = 52) -> list[str]:
    """Return the names of a floor as one line, or as several that fit the panel."""
    separator = "   |   " if floor.is_separate else "    "
    lines = [""]
    for room in floor.rooms:
        joined = separator.join(part for part in (lines[-1], room) if part)
        if len(joined) > longest:
            lines.append(room)
        else:
            lines[-1] = joined
    return lines


def _legend(x: float, y: float) -> list[str]:
    sentences = (
        "Boxes with a space between them do not import each other; boxes that touch may.",
        "Only the packages marked mujoco import it. sim/ground_truth is for scoring only.",
        "Controllers import mjtactile.types and grasp_estimation; examples import public names.",
    )
    return [_text(x, y + 18 * k, sentence, size=12.5) for k, sentence in enumerate(sentences)]


def _colour(room: str) -> str:
    for rooms, colour in COLOURS.items():
        if room in rooms.split():
            return colour
    return GREY


def _box(x: float, y: float, width: float, height: float, fill: str) -> str:
    return (
        f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" rx="5" '
        f'fill="{fill}" stroke="#5c6773"/>'
    )


def _text(
    x: float,
    y: float,
    text: str,
    *,
    size: float = 13,
    weight: str = "normal",
    anchor: str = "start",
    fill: str = "#1c2126",
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size:g}" font-weight="{weight}" '
        f'text-anchor="{anchor}" fill="{fill}" xml:space="preserve">{escape(text)}</text>'
    )


def main() -> None:
    FIGURE.write_text(render((ROOT / "pyproject.toml").read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    main()
