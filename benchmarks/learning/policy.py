"""`mjtactile bench policy`: a policy learned from scratch, and its success rate afterwards.

`examples/learn_to_grasp.py` learns for ten minutes with synthetic touch. The saved policy then
grasps unseen random objects, once with synthetic touch and once with everything simulated. The ten
lines of the documentation page also run for a few thousand decisions, timed. Needs the extra
`learn`.
"""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.runtime.progress import Progress

CHECKOUT = Path(__file__).parents[2]
LEARNER = CHECKOUT / "examples" / "learn_to_grasp.py"
PAGE = CHECKOUT / "docs" / "how-to" / "train.md"
LEVELS = {"-mesh,-pipeline": "sampled, as in training", "auto": "complete simulation"}
SECONDS, SECONDS_QUICK = 600, 40
EPISODES, EPISODES_QUICK = 24, 2
DECISIONS = 2048  # decisions of the ten lines: one update of the learner, the minimum
FIRST_SEED = 5000  # first seed of the evaluation episodes; the learner uses others
SHOWN = 6  # times of the learner's that the table has
ENDS = {
    "held": "held",
    "dropped": "dropped",
    "crushed": "crushed",
    "out of time": "out of time",
    "error": "quasi-static membrane did not converge",
}

Notify = Callable[[str], None]


def run(out: Path, *, quick: bool = False, notify: Notify | None = None) -> dict[str, Any]:
    """Learn, evaluate and time a policy; it takes a quarter of an hour on two cores.

    Args:
        out: Folder; the policy is stored in its policy.npz.
        quick: Learn for a short time, only to check that it works.
        notify: Receiver of progress messages.

    Returns:
        "learned": rows of time, decisions and outcomes of the last hundred episodes; "judged": for
        each level, the numbers of `evaluate`; "ten_lines": decisions per second of the page's
        lines.
    """
    notify = notify or Progress().message
    saved = out / "policy.npz"
    learned = _learn(saved, SECONDS_QUICK if quick else SECONDS, notify)
    evaluated = {}
    for effects in LEVELS:
        notify(f"policy: episodes with --effects={effects}")
        evaluated[effects] = _evaluate(saved, effects, EPISODES_QUICK if quick else EPISODES)
    notify("policy: the ten lines of docs/how-to/train.md")
    ten_lines = _time_page(out, DECISIONS)
    return {"learned": learned, "judged": evaluated, "ten_lines": ten_lines}


def _learn(saved: Path, seconds: int, notify: Notify) -> list[dict[str, Any]]:
    """Return the progress that the example reports while it learns."""
    command = [sys.executable, str(LEARNER), str(saved), str(seconds)]
    rows: list[dict[str, Any]] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=_one_thread()) as learner:
        assert learner.stdout is not None
        for line in learner.stdout:
            report = re.match(r"(\d+) s, (\d+) decisions", line)
            if report:
                rows.append({"seconds": int(report[1]), "decisions": int(report[2])})
            elif line.strip().startswith("{"):
                rows[-1]["ended"] = ast.literal_eval(line.strip())
                notify(f"policy: {rows[-1]}")
    if learner.returncode:
        raise RuntimeError(
            f"{LEARNER.name} ended with {learner.returncode}: mjtactile[learn] lacks?"
        )
    return rows


def _evaluate(saved: Path, effects: str, episodes: int) -> dict[str, Any]:
    """Evaluate the policy on unseen random objects, without exploration noise."""
    folder = saved.parent / f"judged{effects.replace(',', '')}"
    command = [sys.executable, "-m", "mjtactile", "evaluate", "--controller", "policy"]
    command += ["--objects", "random", "--episodes", str(episodes), "--seed", str(FIRST_SEED)]
    command += [f"--effects={effects}", "--worst", "0", "--out", str(folder), "--json"]
    env = _one_thread() | {"MJTACTILE_POLICY": str(saved)}
    ended = subprocess.run(command, capture_output=True, text=True, check=True, env=env)
    return json.loads(ended.stdout)["controllers"]["policy"]


def _time_page(out: Path, decisions: int) -> dict[str, float]:
    """Run the page's lines that learn, with fewer decisions, and return their duration, s."""
    lines = ten_lines(PAGE.read_text(encoding="utf-8"))
    meant = re.search(r"learn\(([\d_]+)\)", lines)
    assert meant is not None
    shorter = lines.replace(meant[0], f"learn({decisions})")
    start = time.perf_counter()
    command = [sys.executable, "-c", shorter]
    subprocess.run(command, check=True, cwd=out, env=_one_thread(), stdout=subprocess.DEVNULL)
    spent = time.perf_counter() - start
    return {"decisions": decisions, "seconds": spent, "meant": int(meant[1])}


def ten_lines(page: str) -> str:
    """Return the page's lines that learn a policy.

    Args:
        page: docs/how-to/train.md.

    Returns:
        The code of the first block that imports a learner.
    """
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    return next(block for block in blocks if "stable_baselines3" in block)


def _one_thread() -> dict[str, str]:
    return dict(os.environ) | {"OPENBLAS_NUM_THREADS": "1"}


# -- table


def table(result: Mapping[str, Any]) -> str:
    """Return the learning progress, the final evaluation, and the rate of the ten lines."""
    rows = _some(result["learned"])
    lines = [
        f"{rows[-1]['decisions']:,} decisions of 0.27 s in {rows[-1]['seconds']} s, on two cores. "
        "Outcomes of the last hundred episodes after".replace(",", " ", 1),
        "",
        "| | " + " | ".join(f"{row['seconds']} s" for row in rows) + " |",
        "|---" * (len(rows) + 1) + "|",
    ]
    for outcome, words in ENDS.items():
        counts = [str(row["ended"].get(outcome, 0)) for row in rows]
        lines.append(f"| {words} | " + " | ".join(counts) + " |")
    lines += [
        "",
        "with exploration noise. Without it, on unseen random objects "
        f"(`--seed {FIRST_SEED}`), the policy held",
        "",
        "| touch | held | 95 % interval | dropped / crushed / stopped / out of time / failed "
        "| largest force, median (worst), N | grip force relative to required force, median |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        _evaluation_row(LEVELS[level], evaluated) for level, evaluated in result["judged"].items()
    ]
    rate = result["ten_lines"]["decisions"] / result["ten_lines"]["seconds"]
    minutes = result["ten_lines"]["meant"] / rate / 60
    lines += [
        "",
        f"The ten lines above, with one environment, make {rate:.0f} decisions per second "
        f"({result['ten_lines']['decisions']} decisions timed, start included): "
        f"{minutes:.0f} minutes.",
    ]
    return "\n".join(lines) + "\n"


def _some(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a few of the rows, evenly spaced in time; the last row is included."""
    chosen = np.unique(np.linspace(0, len(rows) - 1, SHOWN).round().astype(int))
    return [rows[k] for k in chosen]


def _evaluation_row(name: str, evaluated: Mapping[str, Any]) -> str:
    low, high = evaluated["success_interval"]
    ends = [evaluated[end] for end in ("dropped", "crushed", "unsafe", "hung", "error")]
    peak = evaluated["peak_N"]
    return (
        f"| {name} | {evaluated['held']} of {evaluated['episodes']} "
        f"| {100 * low:.0f}-{100 * high:.0f} % | {' / '.join(map(str, ends))} "
        f"| {_known(peak['median'], 2)} ({_known(peak['max'], 2)}) "
        f"| {_known(evaluated['margin']['median'], 1)} |"
    )


def _known(value: float | None, digits: int) -> str:
    """Format a value; "-" for None, which means that no episode has finished yet."""
    return "-" if value is None else f"{value:.{digits}f}"
