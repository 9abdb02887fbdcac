"""Tables of `bench shape`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from benchmarks.shape import foreign_shapes

_LIGHT, _FIRM, _END = 0.06, 0.2, 0.3  # force limits of the groups, N
_SHARP = {"edge": "edges", "point": "corners", "multiple": "two balls"}
_SMALL, _LARGE = 4.2, 30.0  # radii of the evaluated balls, mm

_TIMES = {
    "first": "processor time, ms: first image of a load",
    "update": "… force increased by half: all possible kinds fitted",
    "hold": "… images of a hold",
}

Row = dict[str, Any]


def summary(rows: Iterable[Row]) -> dict[str, Any]:
    """Summarize the rows.

    Args:
        rows: Rows of the benchmark.

    Returns:
        Medians, fractions and counts by name, for tracked sequences, for every touch by default and
        for single images.
    """
    listed = list(rows)
    followed = [row for row in listed if row["stage"] not in ("image", "default")]
    plain = [row for row in listed if row["stage"] == "default"]
    loads = [row for row in plain if row["within"] == "press"]
    presses = [row for row in listed if row["stage"] == "press"]
    sharp = [row for row in presses if row["family"] in _SHARP]
    smooth = [row for row in presses if row["family"] == "smooth"]
    wedges = [row for row in presses if row["name"] == "wedge" and row["force_true_N"] >= _FIRM]
    two = [row for row in presses if row["family"] == "multiple" and row["force_true_N"] >= _FIRM]
    ends = _ends(presses)
    firm = _broad(presses)["firm"]
    return {
        "coverage_nodal": [
            _fraction(_covers(row, "area_nodal_interval_mm2") for row in firm),
            len(firm),
        ],
        "press": _summary(presses),
        "default": _summary(loads),
        "default_ms": {
            "first": _median(row["milliseconds"] for row in loads if row["first"]),
            "update": _median(row["milliseconds"] for row in loads if not row["first"]),
            "hold": _median(row["milliseconds"] for row in plain if row["within"] == "hold"),
        },
        "image": _summary([row for row in listed if row["stage"] == "image"]),
        "nodal": {key: _errors(some, "area_nodal") for key, some in _broad(presses).items()},
        "kind_end": [_fraction(row["kind"] == row["family"] for row in ends), len(ends)],
        "multiple": [_fraction(row["kind"] == "multiple" for row in two), len(two)],
        "edge_off_mm": _median(row["edge_off_mm"] for row in wedges),
        "edge_turn_deg": _median(row["edge_turn_deg"] for row in wedges),
        "force_smooth": _mean_and_worst(smooth, "force_N"),
        "force_smooth_nodal": _mean_and_worst(smooth, "force_nodal_N"),
        "force_sharp": _mean_and_worst(sharp, "force_N"),
        "force_sharp_nodal": _mean_and_worst(sharp, "force_nodal_N"),
        "chi2": {
            name: [_mean(row["chi2"] for row in some), _mean(row["chi2_nodal"] for row in some)]
            for name, some in _sharp(listed).items()
        },
        "first_ms": _median(row["milliseconds"] for row in followed if row["first"]),
        "hold_ms": _median(row["milliseconds"] for row in listed if row["stage"] == "hold"),
        "update_ms": _median(row["milliseconds"] for row in presses if not row["first"]),
        "kinds": _kinds(ends),
        "bodies": len({row["seed"] for row in presses}),
        "images": len(presses),
    }


def _summary(rows: list[Row]) -> dict[str, Any]:
    """Summarize areas, radii, kinds and intervals."""
    broad = _broad(rows)
    balls = [
        row
        for row in rows
        if row["name"] == "ball"
        and _SMALL <= row["radius_true_mm"] <= _LARGE
        and row["force_true_N"] >= _FIRM
    ]
    late = [row for row in rows if row["force_true_N"] >= _END]
    reported = [row for row in broad["firm"] if np.isfinite(row["area_mm2"])]
    bent = [
        row
        for row in rows
        if row["family"] == "smooth" and row["kind"] == "smooth" and row["force_true_N"] >= _FIRM
    ]
    curvatures = [covers for row in bent for covers in _curvatures_cover(row)]
    return {
        "area": {key: _errors(some, "area") for key, some in broad.items()},
        "coverage": [_fraction(_covers(row) for row in reported), len(reported)],
        "coverage_curvature": [_fraction(curvatures), len(curvatures)],
        "radius": _errors(balls, "radius"),
        "kind": [_fraction(row["kind"] == row["family"] for row in late), len(late)],
        "unknown": [_fraction(row["kind"] == "unknown" for row in late), len(late)],
    }


def _broad(rows: list[Row]) -> dict[str, list[Row]]:
    """Group the rows with a contact area by force."""
    broad = [row for row in rows if row["family"] in ("smooth", "flat")]
    firm = [row for row in broad if row["force_true_N"] >= _FIRM]
    return {
        "firm": firm,
        "smooth": [row for row in firm if row["family"] == "smooth"],
        "flat": [row for row in firm if row["family"] == "flat"],
        "light": [row for row in broad if _LIGHT <= row["force_true_N"] < _FIRM],
    }


def _sharp(rows: list[Row]) -> dict[str, list[Row]]:
    """Group rows of sharp indenters by table name: pressed, dragged, and both."""
    pushed = [row for row in rows if row["stage"] in ("press", "drag")]
    named: dict[str, list[Row]] = {}
    for family, name in _SHARP.items():
        own = [row for row in pushed if row["family"] == family]
        named |= {
            f"{name}, {stage}": [row for row in own if row["stage"] == by]
            for by, stage in (("press", "pressed"), ("drag", "dragged"))
        }
        named[name] = own
    named["all three"] = [row for row in pushed if row["family"] in _SHARP]
    return named


def _ends(presses: list[Row]) -> list[Row]:
    """Return the first image of 0.3 N or more of each load."""
    found: dict[int, Row] = {}
    for row in presses:
        if row["force_true_N"] >= _END:
            found.setdefault(row["seed"], row)
    return list(found.values())


def _curvatures_cover(row: Row) -> list[bool]:
    """Return True for each curvature that is within its standard deviation.

    Curvatures that the shape model fixes are left out.
    """
    given = zip(
        row["curvatures_per_m"],
        row["curvatures_true_per_m"],
        row["curvatures_sd_per_m"],
        strict=True,
    )
    return [abs(found - true) <= sd for found, true, sd in given if sd > 0]


def table(result: dict[str, Any]) -> str:
    """Format the table of the page.

    Args:
        result: Of the benchmark.

    Returns:
        Markdown.
    """
    s = result["summary"]
    press, default, image, nodal = s["press"], s["default"], s["image"], s["nodal"]
    estimates = (press, default, image)

    def areas(key: str) -> tuple[str, ...]:
        return *(_both(each["area"][key]) for each in estimates), _both(nodal[key])

    def shares(key: str) -> tuple[str, ...]:
        return *(_part(each[key]) for each in estimates), "none"

    rows = [
        ("quantity", "`contact_shapes`", "every touch", "single image", "nodal estimate"),
        ("---", "---", "---", "---", "---"),
        ("area from 0.2 N, smooth objects and faces, error: median / 90 % within", *areas("firm")),
        ("… smooth objects", *areas("smooth")),
        ("… faces", *areas("flat")),
        ("area, 0.06 to 0.2 N, error", *areas("light")),
        (
            "68 % interval of the area contains the true one, from 0.2 N",
            *shares("coverage")[:3],
            _part(s["coverage_nodal"]),
        ),
        ("the same for curvatures", *shares("coverage_curvature")),
        (
            "radius of balls of 4.2 to 30 mm, from 0.2 N, error",
            *(_both(each["radius"]) for each in estimates),
            "none",
        ),
        ("correct kind at the end of a load to 0.3 N", _part(s["kind_end"]), "", "", "none"),
        ("correct kind, images of 0.3 N or more", *shares("kind")),
        ("… reported as unknown", *shares("unknown")),
        ("two balls at once, reported as `multiple`", _part(s["multiple"]), "", "", "none"),
        ("edge of a wedge: lateral error, mm, median", _number(s["edge_off_mm"]), "", "", "none"),
        (
            "edge of a wedge: rotation error, deg, median",
            _number(s["edge_turn_deg"]),
            "",
            "",
            "none",
        ),
        (
            "normal force of smooth objects, error, N: mean / worst",
            _newtons(s["force_smooth"]),
            "",
            "",
            _newtons(s["force_smooth_nodal"]),
        ),
        (
            "normal force of edges, corners, two balls, error",
            _newtons(s["force_sharp"]),
            "",
            "",
            _newtons(s["force_sharp_nodal"]),
        ),
        *(
            (f"chi-square of the wrench, {name}", f"{now:.2f}", "", "", f"{before:.2f}")
            for name, (now, before) in s["chi2"].items()
            if not name.endswith(("pressed", "dragged"))
        ),
        *(
            (name, _number(s[f"{key}_ms"]), _number(s["default_ms"][key]), "", "")
            for key, name in _TIMES.items()
        ),
    ]
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    lines += ["", *_independent(result["independent"])]
    lines += ["", *foreign_shapes.table(result["foreign"])]
    kinds = "\n".join(
        f"- {name}: " + ", ".join(f"{kind} {count}" for kind, count in reported.items())
        for name, reported in s["kinds"].items()
    )
    mesh = " x ".join(str(count) for count in result["mesh"])
    lines += [
        "",
        f"{s['bodies']} objects, {s['images']} images, mesh {mesh}; counts in brackets. Reported "
        "kinds at the end of loads to 0.3 N:",
        "",
        kinds,
    ]
    return "\n".join(lines)


def _both(found: list[float]) -> str:
    median, maximum, count = found
    return f"{100 * median:.0f} % / {100 * maximum:.0f} % ({count})" if count else "-"


def _part(found: list[float]) -> str:
    part, count = found
    return f"{100 * part:.0f} % ({count})" if count else "-"


def _newtons(found: list[float]) -> str:
    mean, worst, count = found
    return f"{mean:.4f} / {worst:.3f} ({count})" if count else "-"


def _number(found: list[float]) -> str:
    value, count = found
    return f"{value:.2f} ({count})" if count else "-"


def _mean_and_worst(rows: list[Row], name: str) -> list[float]:
    off = [abs(row[name] - row["force_true_N"]) for row in rows]
    return [float(np.mean(off)), float(max(off)), len(off)] if off else [np.nan, np.nan, 0]


def _mean(given: Iterable[float]) -> float:
    values = list(given)
    return float(np.mean(values)) if values else float("nan")


def _independent(balls: list[Row]) -> list[str]:
    """Return table rows of balls of 4 to 30 mm on another solver's membrane."""
    right = sum(row["kind"] == "smooth" for row in balls)
    radius = _errors(balls, "radius")
    place = [row["place_off_mm"] for row in balls]
    body = _errors(balls, "force", fraction=False)
    nodal = _errors(balls, "force_nodal", fraction=False)
    return [
        f"| {len(balls)} balls of 4 to 30 mm, 2 mm deep, independent membrane | contact shape | "
        "nodal estimate, single image |",
        "|---|---|---|",
        f"| classified as smooth | {right} of {len(balls)} | none |",
        f"| radius error: median / worst | {100 * radius[0]:.1f} % / "
        f"{100 * _worst(balls, 'radius_mm', 'radius_true_mm', fraction=True):.0f} % | none |",
        f"| position error, mm: median / worst | {np.median(place):.2f} / {max(place):.2f} | "
        "none |",
        f"| normal force error, N: median / worst | {body[0]:.4f} / "
        f"{_worst(balls, 'force_N', 'force_true_N'):.4f} | {nodal[0]:.4f} / "
        f"{_worst(balls, 'force_nodal_N', 'force_true_N'):.4f} |",
    ]


def _worst(rows: list[Row], name: str, true: str, *, fraction: bool = False) -> float:
    return max(abs(row[name] - row[true]) / (row[true] if fraction else 1.0) for row in rows)


def _errors(rows: list[Row], name: str, *, fraction: bool = True) -> list[float]:
    """Return median and 90th percentile of the error, and the count.

    An unknown value counts as an error of 100 %.
    """
    unit = {"area": "mm2", "area_nodal": "mm2", "radius": "mm"}.get(name, "N")
    true = {"area_nodal": "area", "force_nodal": "force"}.get(name, name)
    if not rows:
        return [float("nan"), float("nan"), 0]
    off = np.array([abs(row[f"{name}_{unit}"] - row[f"{true}_true_{unit}"]) for row in rows])
    scale = np.array([row[f"{true}_true_{unit}"] for row in rows])
    off = np.where(np.isfinite(off), off, scale)
    off = off / scale if fraction else off
    return [float(np.median(off)), float(np.quantile(off, 0.9)), len(rows)]


def _covers(row: Row, name: str = "area_interval_mm2") -> bool:
    low, high = row[name]
    return bool(low <= row["area_true_mm2"] <= high)


def _fraction(given: Iterable[bool]) -> float:
    values = list(given)
    return float(np.mean(values)) if values else float("nan")


def _median(given: Iterable[float]) -> list[float]:
    values = [value for value in given if np.isfinite(value)]
    return [float(np.median(values)) if values else float("nan"), len(values)]


def _kinds(rows: list[Row]) -> dict[str, dict[str, int]]:
    """Count the estimated kinds of each indenter name."""
    found: dict[str, dict[str, int]] = {}
    for row in rows:
        reported = found.setdefault(row["name"], {})
        reported[row["kind"]] = reported.get(row["kind"], 0) + 1
    return found
