"""`mjtactile bench friction`: likelihoods of the signs that the friction filter uses.

Grasps with known friction are run; each image gives the sign of slip, the utilization over the true
coefficient, and the answer of the shear to a change of the grip. They are the source of the
constants in `mjtactile/grasp_estimation/friction_filter.py`. The figure shows the posterior while
an object gets wet.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.errors import SimulationError
from mjtactile.core.scenario import Scenario
from mjtactile.core.toml import read_json
from mjtactile.grasp_estimation import FrictionFilter
from mjtactile.grasp_estimation.friction_filter import GRID
from mjtactile.grasp_estimation.slip_signs import ALL, MOVES, NONE, SOME
from mjtactile.recording.files import write_json
from mjtactile.recording.observer import Observer
from mjtactile.report.figures import new_figure
from mjtactile.runtime.cycle import Cycle
from mjtactile.runtime.grasp import run_grasp

SYNTHETIC, MESH = "synthetic touch", "mesh"
LEVELS = {SYNTHETIC: "-mesh,-pipeline", MESH: "-images"}
TASKS = ("wet", "weigh", "pour", "shake")
CONTROLLERS = ("adaptive", "slip_aware")
OBJECTS = ("vial", "egg", "random")
EPISODES = {SYNTHETIC: 12, MESH: 4}
"""Grasps of each task and controller."""
QUICK = {SYNTHETIC: 1, MESH: 0}
SEED = 61_000
EDGES = (0.0, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1)
_NAMES = {SOME: "some fingers", ALL: "all fingers", MOVES: "distance grows"}
_AIR = 0.004  # minimum height of the gripper, m
_CHANGE = 0.15  # minimum relative change of the grip for an answer
_STICKS, _SLIDES = 0.8, 0.9  # limits of sticking and sliding: utilization over mu
_MIN_ANSWERS = 10
_WET_SEED = 0

Row = dict[str, float]


class _Signs(Observer):
    """Observer that stores the evidence of each image with the true coefficient."""

    sees = False

    def __init__(self) -> None:
        self.rows: list[Row] = []
        self.filters: list[FrictionFilter] = []
        self._filter = FrictionFilter()
        self._time = 0.0
        self._scene: Any = None

    def start(self, session: Any) -> None:
        self._scene = session.rig.scene

    def add(self, cycle: Cycle, view: Any = None, **true: Any) -> None:
        period, self._time = cycle.time - self._time, cycle.time
        if cycle.sent.phase not in ("lift", "hold") or cycle.sent.lift_height < _AIR:
            return
        signs = self._filter.signs(cycle.touch, period)
        if signs is not None:
            friction = float(np.mean([sensor.friction for sensor in self._scene.sensors]))
            row = {"time": cycle.time, "friction": friction, "press": signs.press}
            row |= {"used": max(signs.recent), "sign": signs.slip, "slid": signs.slid}
            self.rows.append(row | {"harder": signs.harder, "more": signs.more})
        self._filter = self._filter.after(cycle.touch, period)
        self.filters.append(self._filter)


def run(
    out: Path, quick: bool = False, resume: bool = False, episodes: int | None = None
) -> dict[str, Any]:
    """Run the grasps of each level.

    Args:
        out: Gets friction.json, wet_posterior.png and the images of each grasp, friction/*.json.
        quick: One grasp with synthetic touch for each task and controller; on the mesh the one of
            the figure alone.
        resume: Continue with the stored grasps.
        episodes: Grasps with synthetic touch of each task and controller; a third on the mesh.

    Returns:
        The frequencies of the signs by utilization, and the answers, for each level.
    """
    counts = QUICK if quick else EPISODES
    if episodes is not None:
        counts = {SYNTHETIC: episodes, MESH: episodes // 3}
    folder = out / "friction"
    folder.mkdir(parents=True, exist_ok=True)
    result: dict[str, Any] = {"episodes": counts, "levels": {}}
    wet = _stored(folder / "figure.json", resume, partial(_wet_grasp, out / "wet_posterior.png"))
    for level, effects in LEVELS.items():
        grasps = [
            _stored(
                folder / f"{level} {task} {controller} {SEED + k}.json".replace(" ", "-"),
                resume,
                partial(_grasp, task, controller, SEED + k, OBJECTS[k % len(OBJECTS)], effects),
            )
            for task in TASKS
            for controller in CONTROLLERS
            for k in range(counts[level])
        ]
        if level == MESH:
            grasps.append(wet)
        result["levels"][level] = frequencies(grasps) | {"grasps": len(grasps)}
        write_json(out / "friction.json", result)
    return result


def _stored(path: Path, resume: bool, grasp: Callable[[], _Signs]) -> list[Row]:
    """Return the images of a grasp; run it unless an interrupted run has stored it."""
    if not (resume and path.is_file()):
        write_json(path, {"images": grasp().rows})
    unknown = float("nan")
    return [
        {name: unknown if value is None else value for name, value in row.items()}
        for row in read_json(path)["images"]
    ]


def _wet_grasp(figure: Path) -> _Signs:
    """Run the grasp of the figure on the mesh, and plot it."""
    wet = _grasp("wet", "adaptive", _WET_SEED, "vial", LEVELS[MESH])
    _plot(wet, figure)
    return wet


def _grasp(task: str, controller: str, seed: int, name: str, effects: str) -> _Signs:
    """Run a grasp; a failed simulation counts until it failed."""
    signs = _Signs()
    scenario = Scenario(
        object=f"random:{seed}" if name == "random" else name,
        task=task,
        controller=controller,
        seed=seed,
        randomization="default",
        effects=effects,
    )
    try:
        run_grasp(scenario, [signs])
    except SimulationError as error:
        signs.message(f"{task}, seed {seed}: {error}")
    return signs


def frequencies(grasps: Sequence[Sequence[Row]]) -> dict[str, Any]:
    """Return the frequencies of each sign by utilization, and quantiles of the answers.

    The coefficient of a grasp is the one that its sensors measure: the median utilization during
    confirmed slips over the true one, if there are two.
    """
    used: list[float] = []
    signs: list[float] = []
    slid: list[float] = []
    answers: dict[str, list[float]] = {"sticking": [], "sliding": []}
    for rows in grasps:
        if not rows:
            continue
        ratio = np.array([row["used"] / row["friction"] for row in rows])
        sign = np.array([row["sign"] for row in rows])
        slid += [row["slid"] / row["friction"] for row in rows if row["sign"] == MOVES]
        confirmed = ratio[sign == MOVES]
        if len(confirmed) > 1:
            ratio = ratio / float(np.clip(np.median(confirmed), 0.7, 1.3))
        used += ratio.tolist()
        signs += sign.tolist()
        for row, own in zip(rows, ratio, strict=True):
            if not abs(row["harder"]) > _CHANGE or _STICKS < own < _SLIDES:
                continue
            kind = "sticking" if own <= _STICKS else "sliding"
            answers[kind].append(row["more"] / row["harder"])
    place = np.digitize(used, EDGES) - 1
    bins = [
        [float(np.mean(np.array(signs)[place == k] == sign)) if (place == k).any() else np.nan]
        for k in range(len(EDGES))
        for sign in _NAMES
    ]
    return {
        "images": [int((place == k).sum()) for k in range(len(EDGES))],
        "signs": np.reshape(bins, (len(EDGES), len(_NAMES))).tolist(),
        "slid": _quartiles(slid),
        "answers": {name: _quartiles(values) for name, values in answers.items()},
    }


def _quartiles(values: Sequence[float]) -> list[float] | None:
    enough = len(values) >= _MIN_ANSWERS
    return np.percentile(values, [25, 50, 75]).tolist() if enough else None


def table(result: Mapping[str, Any]) -> str:
    """Return the frequencies as Markdown."""
    lines = []
    for level, found in result["levels"].items():
        head = " | ".join(f"P({name})" for name in _NAMES.values())
        lines += [f"| {level}: utilization over $\\mu$ | images | {head} |", "|---" * 5 + "|"]
        uppers = [*(f"to {edge:g}" for edge in EDGES[1:]), "above"]
        for upper, count, row in zip(uppers, found["images"], found["signs"], strict=True):
            cells = " | ".join("" if np.isnan(chance) else f"{chance:.4f}" for chance in row)
            lines.append(f"| {upper} | {count} | {cells} |")
        lines.append(f"\nGrasps: {found['grasps']}, seeds from {SEED}.")
        if found["slid"] is not None:
            low, median, high = found["slid"]
            lines.append(
                f"\nUtilization of moving fingers over $\\mu$: {median:.2f} "
                f"(quartiles {low:.2f} to {high:.2f})."
            )
        for name, quartiles in found["answers"].items():
            if quartiles is not None:
                low, median, high = quartiles
                lines.append(
                    f"\nAnswer of the shear, {name}: {median:.2f} of the change of the grip "
                    f"(quartiles {low:.2f} to {high:.2f})."
                )
        lines.append("")
    return "\n".join(lines)


def _plot(wet: _Signs, path: Path) -> None:
    """Plot the posterior over time, with the true coefficient, utilization, slip and grip."""
    if not wet.rows or (figure := new_figure(path.name, (8.0, 5.0))) is None:
        return
    time = np.array([row["time"] for row in wet.rows])
    time = time - time[0]
    count = min(len(time), len(wet.filters))
    density = np.array([friction.density() for friction in wet.filters[:count]]).T
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    above.pcolormesh(time[:count], GRID, density**0.5, cmap="Blues", shading="nearest")
    above.plot(time, [row["friction"] for row in wet.rows], "k", label="ground truth")
    above.plot(
        time,
        [row["used"] for row in wet.rows],
        color="#d08020",
        label="utilization, largest of 0.15 s",
    )
    low = [friction.utilization(0.01) for friction in wet.filters[:count]]
    above.plot(time[:count], low, color="#1f5fa8", label="risk of slip 1 %")
    slips = [row["sign"] != NONE for row in wet.rows]
    above.plot(time[slips], np.full(sum(slips), GRID[0]), "|", color="#c0221c", label="slip report")
    above.set(ylabel="friction coefficient")
    above.legend(loc="upper right", fontsize="small", ncols=2)
    below.plot(time, [row["press"] for row in wet.rows], color="#1f5fa8")
    below.set(xlabel="time [s]", ylabel="grip [N]", ylim=(0, None))
    figure.savefig(path)
