"""Tables of `bench shape`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

_LIGHT, _FIRM, _END = 0.06, 0.2, 0.3  # N
_SMALL, _LARGE = 4.2, 30.0  # mm, of balls whose radius is asked for

Row = dict[str, Any]


def summary(rows: Iterable[Row]) -> dict[str, Any]:
    """What the rows come to.

    Args:
        rows: Of the benchmark.

    Returns:
        Medians, shares and how many there were, by name.
    """
    images = [row for row in rows if row["looked"] == "image"]
    presses = [row for row in rows if row["looked"] == "press" and row["family"] != "several"]
    broad = [row for row in images if row["family"] in ("smooth", "face")]
    firm = [row for row in broad if row["force_true_N"] >= _FIRM]
    light = [row for row in broad if _LIGHT <= row["force_true_N"] < _FIRM]
    balls = [
        row
        for row in images
        if row["name"] == "ball"
        and _SMALL <= row["radius_true_mm"] <= _LARGE
        and row["force_true_N"] >= _FIRM
    ]
    one_image = [
        row for row in images if row["force_true_N"] >= _END and row["family"] != "several"
    ]
    wedges = [row for row in images if row["name"] == "wedge" and row["force_true_N"] >= _FIRM]
    said = [row for row in firm if np.isfinite(row["area_mm2"])]
    return {
        "area_firm": _errors(firm, "area"),
        "area_firm_nodal": _errors(firm, "area_nodal"),
        "area_smooth": _errors([row for row in firm if row["family"] == "smooth"], "area"),
        "area_face": _errors([row for row in firm if row["family"] == "face"], "area"),
        "area_light": _errors(light, "area"),
        "area_light_nodal": _errors(light, "area_nodal"),
        "coverage": [_share(_covers(row) for row in said), len(said)],
        "radius": _errors(balls, "radius"),
        "family_press": [_share(row["kind"] == row["family"] for row in presses), len(presses)],
        "family_image": [_share(row["kind"] == row["family"] for row in one_image), len(one_image)],
        "unknown": [_share(row["kind"] == "unknown" for row in one_image), len(one_image)],
        "several_unknown": [
            _share(
                row["kind"] == "unknown"
                for row in images
                if row["family"] == "several" and row["force_true_N"] >= _FIRM
            ),
            sum(row["family"] == "several" and row["force_true_N"] >= _FIRM for row in images),
        ],
        "edge_off_mm": _median(row["edge_off_mm"] for row in wedges),
        "edge_turn_deg": _median(row["edge_turn_deg"] for row in wedges),
        "force_smooth": _errors(
            [row for row in images if row["family"] == "smooth"], "force", share=False
        ),
        "force_smooth_nodal": _errors(
            [row for row in images if row["family"] == "smooth"], "force_nodal", share=False
        ),
        "milliseconds": _median(row["milliseconds"] for row in images),
        "kinds": _kinds(presses),
        "bodies": len({row["seed"] for row in images}),
        "images": len(images),
    }


def table(result: dict[str, Any]) -> str:
    """The table of the page.

    Args:
        result: Of the benchmark.

    Returns:
        Markdown.
    """
    s = result["summary"]

    def errors(key: str) -> str:
        median, most, count = s[key]
        if not count:
            return "-"
        return f"{100 * median:.0f} % / {100 * most:.0f} % ({count})"

    def share(key: str) -> str:
        part, count = s[key]
        if not count:
            return "-"
        return f"{100 * part:.0f} % ({count})"

    def newtons(key: str) -> str:
        median, most, count = s[key]
        return f"{median:.4f} / {most:.3f} ({count})"

    def off(key: str) -> str:
        median, count = s[key]
        return f"{median:.2f} ({count})"

    rows = [
        ("what", "body", "nodal estimate"),
        ("---", "---", "---"),
        (
            "contact area from 0.2 N on, smooth and faces, error: median / 90 % within",
            errors("area_firm"),
            errors("area_firm_nodal"),
        ),
        ("of smooth bodies", errors("area_smooth"), ""),
        ("of faces", errors("area_face"), ""),
        ("contact area, 0.06 to 0.2 N", errors("area_light"), errors("area_light_nodal")),
        ("68 % interval of the area has the true one", share("coverage"), "none"),
        ("radius of balls of 4.2 to 30 mm, from 0.2 N on", errors("radius"), "none"),
        ("kind right, press up to 0.3 N", share("family_press"), "none"),
        ("kind right, one image of 0.3 N or more", share("family_image"), "none"),
        ("said to be unknown, of these", share("unknown"), "none"),
        ("two balls at once said to be unknown", share("several_unknown"), "none"),
        ("a wedge's edge: off across it, mm, median", off("edge_off_mm"), "none"),
        ("a wedge's edge: turned, deg, median", off("edge_turn_deg"), "none"),
        (
            "normal force of smooth bodies, N: median / 90 % within",
            newtons("force_smooth"),
            newtons("force_smooth_nodal"),
        ),
        ("time, ms an image, median", off("milliseconds"), ""),
    ]
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    lines += ["", *_independent(result["independent"])]
    kinds = "; ".join(
        f"{name}: " + ", ".join(f"{kind} {count}" for kind, count in said.items())
        for name, said in s["kinds"].items()
    )
    mesh = " x ".join(str(count) for count in result["mesh"])
    lines += [
        "",
        f"{s['bodies']} bodies, {s['images']} images, mesh {mesh}; in brackets how many. What was "
        f"said of presses up to 0.3 N: {kinds}.",
    ]
    return "\n".join(lines)


def _independent(balls: list[Row]) -> list[str]:
    """Of balls of 4 to 30 mm under the sheet of another solver."""
    right = sum(row["kind"] == "smooth" for row in balls)
    radius = _errors(balls, "radius")
    place = [row["place_off_mm"] for row in balls]
    body = _errors(balls, "force", share=False)
    nodal = _errors(balls, "force_nodal", share=False)
    return [
        f"| {len(balls)} balls of 4 to 30 mm, 2 mm deep, under an independent sheet | body | nodal "
        "estimate, one image alone |",
        "|---|---|---|",
        f"| called smooth | {right} of {len(balls)} | none |",
        f"| radius, error: median / worst | {100 * radius[0]:.1f} % / "
        f"{100 * _worst(balls, 'radius_mm', 'radius_true_mm', share=True):.0f} % | none |",
        f"| place, mm: median / worst | {np.median(place):.2f} / {max(place):.2f} | none |",
        f"| normal force, N: median / worst | {body[0]:.4f} / "
        f"{_worst(balls, 'force_N', 'force_true_N'):.4f} | {nodal[0]:.4f} / "
        f"{_worst(balls, 'force_nodal_N', 'force_true_N'):.4f} |",
    ]


def _worst(rows: list[Row], name: str, true: str, *, share: bool = False) -> float:
    return max(abs(row[name] - row[true]) / (row[true] if share else 1.0) for row in rows)


def _errors(rows: list[Row], name: str, *, share: bool = True) -> list[float]:
    """Median and 90th percentile of the error, and of how many; what is unknown counts as an error
    of all."""
    unit = {"area": "mm2", "area_nodal": "mm2", "radius": "mm"}.get(name, "N")
    true = {"area_nodal": "area", "force_nodal": "force"}.get(name, name)
    if not rows:
        return [float("nan"), float("nan"), 0]
    off = np.array([abs(row[f"{name}_{unit}"] - row[f"{true}_true_{unit}"]) for row in rows])
    scale = np.array([row[f"{true}_true_{unit}"] for row in rows])
    off = np.where(np.isfinite(off), off, scale)
    off = off / scale if share else off
    return [float(np.median(off)), float(np.quantile(off, 0.9)), len(rows)]


def _covers(row: Row) -> bool:
    low, high = row["area_interval_mm2"]
    return bool(low <= row["area_true_mm2"] <= high)


def _share(given: Iterable[bool]) -> float:
    values = list(given)
    return float(np.mean(values)) if values else float("nan")


def _median(given: Iterable[float]) -> list[float]:
    values = [value for value in given if np.isfinite(value)]
    return [float(np.median(values)) if values else float("nan"), len(values)]


def _kinds(rows: list[Row]) -> dict[str, dict[str, int]]:
    """Of each name, what it was said to be, and how often."""
    found: dict[str, dict[str, int]] = {}
    for row in rows:
        said = found.setdefault(row["name"], {})
        said[row["kind"]] = said.get(row["kind"], 0) + 1
    return found
