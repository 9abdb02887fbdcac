"""Summary and tables of `mjtactile bench uncertainty`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

# minimum true force of a touch, N; maximum true force without a touch, N
FORCE_MIN = 0.02
NOTHING = 1e-3
FAR = 5.0  # maximum error, in standard deviations
COARSE = ("sharp_edge", "small_feature")
"""Flags of a mesh that is too coarse for the indenter: the true force is then that of vertices."""
UNSURE = ("penetration", "wrinkles")
"""Flags of an inaccurate contact simulation; touches of these scenes are counted separately."""
# force limits of the area groups, N
_LIGHT = 0.06
_STRONG = 0.5

Row = dict[str, Any]


def summary(scenes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Summarize all images whose status is ok, grouped by type of touch."""
    rows = [
        row | {key: scene[key] for key in ("seed", "kind", "shape", "sensor", "flags")}
        for scene in scenes
        for row in scene["rows"]
    ]
    known = [row for row in rows if row["wrench"] is not None]
    steady = [row for row in known if not row["rattles"]]
    touches = [row for row in steady if _force(row) > FORCE_MIN]
    sure = [row for row in touches if not set(UNSURE) & set(row["flags"])]
    groups = {
        "everything that is ok": known,
        "nothing touches": [row for row in steady if abs(_force(row)) < NOTHING],
        "touches": sure,
        "touches that nothing flags": [row for row in sure if not row["flags"]],
        "touches of edges and tips that the mesh is flagged for": [
            row for row in sure if set(COARSE) & set(row["flags"])
        ],
    }
    for key in ("kind", "sensor", "shape"):
        for value in sorted({row[key] for row in sure}):
            groups[f"{key}: {value}"] = [row for row in sure if row[key] == value]
    groups["touches that the simulation flags"] = [
        row for row in touches if set(UNSURE) & set(row["flags"])
    ]
    groups["touches at rest whose true force rattles"] = [
        row for row in known if row["rattles"] and _force(row) > FORCE_MIN
    ]
    reported = [row["status"] for row in rows]
    return {
        "scenes": len(scenes),
        "failed": [scene["error"] for scene in scenes if scene["error"]],
        "images": len(rows),
        "status": {status: reported.count(status) for status in sorted(set(reported))},
        "groups": {name: _evaluate(group) for name, group in groups.items() if group},
        "areas": _areas(known),
    }


def _force(row: Row) -> float:
    return -row["wrench_true"][2]


def _evaluate(rows: Sequence[Row]) -> dict[str, Any]:
    error = np.array([row["wrench"] for row in rows]) - [row["wrench_true"] for row in rows]
    sd = np.array([row["sd"] for row in rows])
    z = error / sd
    far = np.abs(z) > FAR
    seeds = np.array([row["seed"] for row in rows])
    return {
        "images": len(rows),
        "scenes": len(set(seeds)),
        "chi_square": (z**2).mean(axis=0),
        "far": far.sum(axis=0),
        "far_any": int(far.any(axis=1).sum()),
        "far_scenes": len(set(seeds[far.any(axis=1)])),
        "worst": np.abs(z).max(axis=0),
        "error_N": np.abs(error[:, :3]).mean(axis=0),
        "sd_N": np.median(sd[:, :3], axis=0),
    }


def _areas(rows: Sequence[Row]) -> dict[str, Any]:
    """Compute the ratio of estimated to true area, for single patches."""
    known = [row for row in rows if row["area"] and row["area_true"] and row["touching"]]
    groups = {
        "all": known,
        f"below {_LIGHT:g} N": [row for row in known if _force(row) < _LIGHT],
        f"{_LIGHT:g} to {_STRONG:g} N": [row for row in known if _LIGHT <= _force(row) < _STRONG],
        f"from {_STRONG:g} N on": [row for row in known if _force(row) >= _STRONG],
    }
    return {
        name: _shares(np.array([row["area"] / row["area_true"] for row in group]))
        for name, group in groups.items()
        if group
    }


def _shares(ratio: np.ndarray) -> dict[str, Any]:
    return {
        "images": len(ratio),
        "median_error": float(np.median(np.abs(ratio - 1))),
        "median": float(np.median(ratio)),
        "within_10_percent": float((np.abs(ratio - 1) < 0.1).mean()),
        "range": np.percentile(ratio, [10, 90]),
    }


_LABELS = {
    "everything that is ok": "all with status `ok`",
    "nothing touches": "no contact",
    "touches": "contacts",
    "touches that nothing flags": "contacts without a flag",
    "touches of edges and tips that the mesh is flagged for": "contacts flagged `sharp_edge` or "
    "`small_feature`",
    "touches that the simulation flags": "contacts flagged `penetration` or `wrinkles`",
    "kind: press": "kind: load",
    "kind: rhythm": "kind: cyclic load",
    "touches at rest whose true force rattles": "contacts at rest with jumps of the true force",
}


def table(result: Mapping[str, Any]) -> str:
    """Format the result in Markdown."""
    status = ", ".join(f"{count} {name}" for name, count in result["status"].items())
    lines = [
        f"{result['images']} images of {result['scenes']} scenes: {status}; "
        f"{len(result['failed'])} scenes could not be simulated.",
        "",
        "| chi-square of each component | images | Fx, Fy | Fz | Tx, Ty, Tz "
        f"| beyond {FAR:g} sd: Fz; any (scenes) | largest Fz error, sd |",
        "|" + "---|" * 7,
    ]
    for name, g in result["groups"].items():
        chi = [f"{value:.2f}" for value in g["chi_square"]]
        groups = " | ".join(", ".join(part) for part in (chi[:2], chi[2:3], chi[3:]))
        lines.append(
            f"| {_LABELS.get(name, name)} | {g['images']} | {groups} | "
            f"{g['far'][2]}; {g['far_any']} ({g['far_scenes']}) | {g['worst'][2]:.1f} |"
        )
    lines += [
        "",
        "| contact area, one patch | images | median error | estimated/true: median (10-90 %) | "
        "within 10 % |",
        "|---|---|---|---|---|",
    ]
    for name, a in result["areas"].items():
        lines.append(
            f"| {name} | {a['images']} | {100 * a['median_error']:.0f} % | {a['median']:.2f} "
            f"({a['range'][0]:.2f}-{a['range'][1]:.2f}) | {100 * a['within_10_percent']:.0f} % |"
        )
    return "\n".join([*lines, ""])
