"""`mjtactile bench cube-grasps`: force on cubes that are wider than the frame, in the loop of
`mjtactile grasp`.

Each cube stands on a table. The jaws hold it with 1, 2 and 3 N in turn. Estimated forces are
compared with the ground truth.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.errors import MjtactileError
from mjtactile.core.scenario import Scenario
from mjtactile.recording.observer import Observer
from mjtactile.runtime.controller import Controller
from mjtactile.runtime.cycle import Cycle
from mjtactile.runtime.grasp import run_grasp
from mjtactile.types import Command, Observation

SENSORS = ("dense", "fine", "paper16", "round30")
FORCES = (1.0, 2.0, 3.0)
ALLOWED = 0.03
"""Required relative error of the force."""
_HOLD = 1.2  # duration of the hold at each force, s
_COUNTED = 0.5  # duration of the evaluated part at its end, s
_TOUCH = 0.08  # N
_CLOSING = 0.025  # m/s
_GAIN = 0.03  # opening speed per force error, m/s/N
_SPEED_MAX = 0.01  # m/s
_FORCE_LIMIT = 8.0  # force limit of the servo, N

_FILE = """<mujoco model="cube">
  <custom>
    <numeric name="break_force_N" data="50"/><text name="material" data="solid"/>
    <numeric name="rotation_deg" data="0.01"/>
  </custom>
  <worldbody>
    <geom name="stand" type="box" size="0.01 0.01 {stand}" pos="0 0 {stand}"/>
    <body name="object" pos="0 0 {height}" quat="{w} 0 0 {z}">
      <freejoint/>
      <geom name="cube" type="box" size="{half} {half} {half}" mass="0.03"/>
    </body>
  </worldbody>
</mujoco>
"""
_STAND = 0.005  # half the height of the stand, m


@dataclass(frozen=True)
class Cube:
    """Cube with an edge of `size` m on a stand, rotated by `yaw` degrees relative to the
    fingers."""

    size: float
    yaw: float = 2.0

    def write(self, folder: Path) -> Path:
        """Write the object file; return its path."""
        path = folder / f"cube_{1e3 * self.size:g}_{self.yaw:g}.xml"
        half = self.size / 2
        angle = math.radians(self.yaw) / 2
        text = _FILE.format(
            half=half, stand=_STAND, height=2 * _STAND + half, w=math.cos(angle), z=math.sin(angle)
        )
        path.write_text(text, encoding="utf-8")
        return path


CUBES = (Cube(0.03), Cube(0.04), Cube(0.05), Cube(0.07))
CASES: Sequence[tuple[str, Cube, str]] = (
    *((sensor, cube, "default") for sensor in SENSORS for cube in CUBES),
    ("dense", Cube(0.05), "0.005N"),
    ("dense", Cube(0.05, yaw=10.0), "default"),
)
"""Sensor, cube and accuracy of the simulation."""


def run(
    out: Path, *, quick: bool = False, notify: Callable[[str], None] = lambda _: None
) -> dict[str, Any]:
    """Hold every cube with every sensor; ten minutes of a processor.

    Args:
        out: Folder, for the object files.
        quick: The first case only.
        notify: Receiver of a message for every cube.

    Returns:
        "rows", one per sensor, cube, mesh and force.
    """
    rows: list[Mapping[str, Any]] = []
    out.mkdir(parents=True, exist_ok=True)
    for sensor, cube, accuracy in CASES[:1] if quick else CASES:
        notify(f"cube-grasps: {sensor}, {1e3 * cube.size:g} mm, {cube.yaw:g} degrees")
        options = {} if accuracy == "default" else {"accuracy": accuracy}
        case = {"sensor": sensor, "size": cube.size, "yaw": cube.yaw, "mesh": accuracy}
        rows += [case | dict(row) for row in grasp(cube, sensor, out, **options)]
    return {"rows": rows}


def staircase(observation: Observation) -> Command:
    """Close until contact, hold FORCES for `_HOLD` s each, open."""
    command = replace(observation.command, force_limit=_FORCE_LIMIT)
    forces = [touch.force_normal for touch in observation.touch]
    stage = int(command.memory.get("stage", -1))
    time = command.memory.get("time", 0.0) + observation.period
    if stage < 0 and all(force > _TOUCH for force in forces):
        stage, time = 0, 0.0
    if 0 <= stage < len(FORCES) and time >= _HOLD:
        stage, time = stage + 1, 0.0
    command = replace(command, memory={"stage": stage, "time": time})
    if stage >= len(FORCES):
        opened = observation.gripper.opening + _CLOSING * observation.period
        phase = "done" if time > _HOLD else "release"
        return replace(command, phase=phase, opening=opened)
    if stage < 0:
        phase, speed = "approach", _CLOSING
    else:
        phase = "regulate"
        mean = float(np.mean(forces))
        error = FORCES[stage] - mean if math.isfinite(mean) else 0.0
        speed = max(-_SPEED_MAX, min(_SPEED_MAX, _GAIN * error))
    opening = command.opening - speed * observation.period
    actual = observation.gripper.opening
    opening = max(actual - 0.004, min(actual + 0.004, opening))
    return replace(command, phase=phase, opening=opening)


@dataclass
class _Holds(Observer):
    """Touches of the counted part of each hold: force, its sd and ground truth, N, and status."""

    rows: list[tuple[int, float, float, float, str]] = field(default_factory=list)
    flags: Callable[[], Sequence[str]] = list

    def start(self, session: Any) -> None:
        self.flags = lambda: sorted(session.flags)

    def add(self, cycle: Cycle, view: Any = None, **truth: Any) -> None:
        memory = cycle.sent.memory
        stage = int(memory.get("stage", -1))
        if not 0 <= stage < len(FORCES) or memory["time"] < _HOLD - _COUNTED:
            return
        for touch, true in zip(cycle.touch, truth["force_normal_true"], strict=True):
            status = str(touch.status.code)
            self.rows.append((stage, touch.force_normal, touch.force_normal_sd, true, status))


def grasp(cube: Cube, sensor: str, folder: Path, **options: Any) -> Sequence[Mapping[str, Any]]:
    """Hold `cube` and return one row per force. `options` are those of the scenario."""
    scenario = Scenario(object=str(cube.write(folder)), sensor=sensor, **options)
    observed = _Holds()
    try:
        controller = Controller(Path(__file__), staircase)
        reason = run_grasp(scenario, [observed], controller=controller).reason
    except MjtactileError as error:
        reason = str(error)
    flags = observed.flags()
    rows = []
    for stage, force in enumerate(FORCES):
        own = [row for row in observed.rows if row[0] == stage]
        rows.append({"target_N": force, "flags": flags, "reason": reason} | _summary(own))
    return rows


def _summary(rows: Sequence[tuple[int, float, float, float, str]]) -> dict[str, Any]:
    """Return true force, N, error, standard deviation and status of the rows of one force."""
    if not rows:
        return {"images": 0, "unknown": 0}
    _, estimate, sd, true, status = (np.array(column) for column in zip(*rows, strict=True))
    known = np.isfinite(estimate)
    any_known = bool(known.any())
    return {
        "images": len(rows),
        "unknown": int((~known).sum()),
        "true_N": float(true.mean()),
        "error": float((estimate - true)[known].mean() / true[known].mean()) if any_known else None,
        "sd": float(sd[known].mean() / true[known].mean()) if any_known else None,
        "status": sorted(set(status.tolist()) - {"ok"}),
    }


def table(result: Mapping[str, Any]) -> str:
    """Return the table in Markdown: one row per sensor, cube and mesh."""
    heads = " | ".join(f"{force:g} N: error ± sd, %" for force in FORCES)
    lines = [f"| sensor | cube | {heads} | flags | end |", "|---" * (4 + len(FORCES)) + "|"]
    rows = result["rows"]
    for key, group in itertools.groupby(rows, key=_case):
        sensor, size, yaw, mesh = key
        own = list(group)
        name = f"{1e3 * size:g} mm" + ("" if yaw == CUBES[0].yaw else f", {yaw:g} degrees")
        name += "" if mesh == "default" else ", finer mesh"
        cells = " | ".join(_cell(row) for row in own)
        flags = ", ".join(f"`{flag}`" for flag in own[0]["flags"]) or "—"
        end = "stopped" if own[0]["reason"] else "—"
        lines.append(f"| `{sensor}` | {name} | {cells} | {flags} | {end} |")
    off = [row for row in rows if abs(row.get("error") or 0.0) > ALLOWED]
    counts = {
        "all": rows,
        "force unknown": [row for row in rows if row.get("error") is None],
        f"error above {100 * ALLOWED:g} %": off,
        "of them above 2 sd": [row for row in off if abs(row["error"]) > 2 * row["sd"]],
        "of them without a flag": [row for row in off if not row["flags"]],
    }
    lines += ["", "| holds | count |", "|---|---|"]
    lines += [f"| {name} | {len(holds)} |" for name, holds in counts.items()]
    return "\n".join(lines) + "\n"


def _case(row: Mapping[str, Any]) -> tuple[Any, ...]:
    return row["sensor"], row["size"], row["yaw"], row["mesh"]


def _cell(row: Mapping[str, Any]) -> str:
    if row.get("error") is None:
        return "unknown" if row["images"] else "—"
    unknown = f" ({100 * row['unknown'] / row['images']:.0f} % unknown)" if row["unknown"] else ""
    return f"{100 * row['error']:+.1f} ± {100 * row['sd']:.1f}{unknown}"
