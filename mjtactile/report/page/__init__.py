"""`summary.html` of a run, without network: curves, images with a slider, rotatable membranes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.recording.files import write_text
from mjtactile.recording.log_schema import Seen
from mjtactile.recording.reader import Recording
from mjtactile.report.html import document, flag_table, is_known, script_data, table
from mjtactile.report.page.data import page_data

_SCRIPTS = ("curves.js", "membranes.js", "moment.js")
_STYLE = """canvas{width:100%;touch-action:none;border:1px solid #e6e6e6;box-sizing:border-box}
#chart{height:320px;cursor:crosshair}canvas.membrane{height:320px;cursor:grab}
.row{display:flex;gap:1em}.row>div{flex:1;min-width:0}.row>div.scene{flex:0 0 240px}
img.camera{width:100%;display:block}#readout{font-size:13px;min-height:2.9em}#slider{width:60%;vertical-align:middle}
.hint{color:#666;font-size:13px}
.columns{display:flex;flex-wrap:wrap;align-items:flex-start;gap:0 3em}h3{margin:.4em 0 .2em}"""
_FACTS: tuple[tuple[str, str, str], ...] = (
    ("outcome", "outcome", ""),
    ("task", "task", ""),
    ("success_criterion", "success", ""),
    ("controller", "controller", ""),
    ("seed", "seed", ""),
    ("reason", "because", ""),
    ("error", "error", ""),
    ("material", "material", ""),
    ("status", "status", ""),
    ("hold_force_N", "grip force, estimated", "N"),
    ("hold_force_true_N", "grip force, ground truth", "N"),
    ("peak_force_N", "maximum, estimated", "N"),
    ("peak_force_true_N", "maximum, ground truth", "N"),
    ("slip_mm_true", "slip, ground truth", "mm"),
    ("force_error_estimate_N", "simulation error of the force, estimated", "N"),
    ("peak_stress_kPa_true", "maximum stress, ground truth", "kPa"),
    ("stiffness_N_m", "stiffness", "N/m"),
    ("modulus_kPa", "modulus, for flat faces", "kPa"),
    ("relaxation_time_s", "relaxation", "s"),
    ("deformation_mm", "gave way", "mm"),
    ("permanent_set_mm", "permanent deformation", "mm"),
    ("real_time_factor", "speed", "x real time"),
    ("perception_ms_median", "perception, median", "ms per cycle"),
    ("recording_problem", "recording", ""),
)
"""Key of a summary, label, unit."""


def write_page(
    path: Path,
    recording: Recording,
    strip: Sequence[tuple[Seen, Any]],
    summary: Mapping[str, Any],
    snapshot: Seen | None = None,
) -> None:
    """Write the HTML page of a run to `path`, with the command's `summary`.

    The `strip` are cycles with their scenes. The page opens at the cycle `snapshot`.
    """
    page = document(_title(summary), _body(recording, strip, summary, snapshot), style=_STYLE)
    write_text(path, page)


def _title(summary: Mapping[str, Any]) -> str:
    return f"{summary.get('object', '?')}: {summary.get('outcome', summary.get('material', '?'))}"


def _body(
    recording: Recording,
    strip: Sequence[tuple[Seen, Any]],
    summary: Mapping[str, Any],
    snapshot: Seen | None,
) -> Iterator[str]:
    yield f"<h1>{escape(_title(summary))}</h1>"
    yield f'<div class="columns">{_facts(summary)}{_fingers(recording)}</div>'
    yield _flags(recording)
    if len(recording):
        data = page_data(recording, strip, snapshot)
        yield _curves(data)
        yield _moment(data, scene=any(shot["scene"] for shot in data["shots"]))
        yield script_data(data)
        scripts = [Path(__file__).parent / name for name in _SCRIPTS]
        yield from (f"<script>{path.read_text(encoding='utf-8')}</script>" for path in scripts)
    else:
        yield "<p>The run ended before the first cycle.</p>"
    yield _simulated(recording)
    yield _provenance(recording)


def _facts(summary: Mapping[str, Any]) -> str:
    summary = {"task": summary.get("scenario", {}).get("task")} | dict(summary)
    rows = [
        [escape(label), escape(_words(summary[key], unit))]
        for key, label, unit in _FACTS
        if is_known(summary.get(key))
    ]
    probability = summary.get("probability", {})
    rows += [[escape(kind), f"{100 * p:.0f} %"] for kind, p in probability.items()]
    return table([], rows)


def _flags(recording: Recording) -> str:
    """Return the table of reasons for reduced simulation accuracy."""
    if not recording.flags:
        return ""
    text = "<h2>Flags</h2><p>Causes of reduced accuracy of the simulated forces.</p>"
    return text + flag_table(recording.flags)


def _words(value: Any, unit: str) -> str:
    return f"{value:#.3g} {unit}".strip() if isinstance(value, float) else f"{value} {unit}".strip()


def _fingers(recording: Recording) -> str:
    """Return the table of each finger's time of sticking, partial and full slip, or unknown."""
    if len(recording) < 2 or "slip_state" not in recording.columns:
        return ""
    period = float(np.median(np.diff(recording.column("time")[:, 0])))
    names = ("sticking", "incipient", "slipping")
    rows = []
    for finger, name in enumerate(recording.fingers):
        slips = [slip[finger] for slip in recording.columns["slip_state"]]
        blind = [status[finger] for status in recording.columns["status"] if status[finger] != "ok"]
        why = f" ({escape(max(set(blind), key=blind.count))})" if blind else ""
        rows.append(
            [
                escape(name),
                *(f"{period * slips.count(name):.2f} s" for name in names),
                f"{period * len(blind):.2f} s{why}",
            ]
        )
    return table(["slip state", *names, "unknown"], rows)


def _curves(data: Mapping[str, Any]) -> str:
    options = "".join(
        f'<option value="{k}">{escape(plot["label"])}</option>'
        for k, plot in enumerate(data["plots"])
    )
    return (
        f'<h2>Over time</h2><p><select id="plot">{options}</select> <span '
        'class="hint">wheel: zoom; drag: move in time; double click: show all; click: '
        "select the moment below. Bands are two standard deviations, dashed lines are the "
        'ground truth of a simulation.</span></p><canvas id="chart"></canvas><p '
        'id="readout"></p>'
    )


def _moment(data: Mapping[str, Any], *, scene: bool) -> str:
    last = len(data["shots"]) - 1
    parts = [
        '<h2>At <span id="moment">-</span></h2><p><input id="slider" type="range" '
        f'min="0" max="{max(last, 0)}" value="0"> <button id="play">play</button> '
        '<span class="hint">drag a membrane to rotate it, wheel: zoom</span></p>'
    ]
    if scene:
        panels = [
            '<div class="scene"><h3>the scene</h3><img id="scene" class="scene" alt="the '
            'scene"></div>'
        ]
    else:
        panels = []
    for finger, name in enumerate(data["fingers"]):
        has_traction = any(
            shot["pictures"][finger : finger + 1] not in ([], [None]) for shot in data["shots"]
        )
        if has_traction:
            camera = f'<img class="camera" alt="camera of {escape(name)}, ellipses fitted">'
        else:
            camera = '<img class="camera" alt="" hidden><p>no image was kept</p>'
        panels.append(
            f'<div><h3>{escape(name)}</h3>{camera}<canvas class="membrane"></canvas></div>'
        )
    return "".join(
        [
            *parts,
            f'<div class="row">{"".join(panels)}</div><noscript>The figures need '
            "JavaScript.</noscript>",
        ]
    )


def _simulated(recording: Recording) -> str:
    """Return the tables of effects with reason and cost, and of randomized values."""
    how = recording.notes.get("simulated")
    if not isinstance(how, Mapping):
        return ""

    def rows(on: bool) -> list[list[str]]:
        return [
            [
                escape(row["effect"]),
                _cost(row["cost_ms_per_s"]),
                _number(row["left_out_N"], 1e3),
                _number(row["left_out_um"]),
                escape(row["why"]),
            ]
            for row in how["effects"]
            if (row["on"] and row["built"]) == on
        ]

    head = ["effect", "cost, ms per simulated s", "error without it, mN", "um", "why"]
    randomized = ", ".join(
        f"{name} {value}" for name, value in recording.notes.get("randomized", {}).items()
    )
    has_traction = ""
    if randomized:
        has_traction = (
            "<details><summary>randomized values of this "
            f"world</summary><p>{escape(randomized)}</p></details>"
        )
    return (
        "<h2>Simulated effects</h2><p>Membranes of "
        f"{escape(' x '.join(map(str, how['mesh'])))} vertices, steps of "
        f"{how['timestep_ms']:.3g} ms. Costs and errors were measured on the shipped sensors "
        "(<code>mjtactile "
        f"effects</code>).</p>{table(head, rows(True), text=True)}<details><summary>disabled "
        f"effects</summary>{table(head, rows(False), text=True)}</details>{has_traction}"
    )


def _cost(value: float | None) -> str:
    """Format a cost. A measured cost below zero is within the noise."""
    return "about 0" if value is not None and value <= 0 else _number(value)


def _number(value: float | None, scale: float = 1.0) -> str:
    return "-" if value is None or math.isnan(value) else f"{scale * value:.3g}"


def _provenance(recording: Recording) -> str:
    header = recording.header
    versions = ", ".join(
        f"{name} {version}" for name, version in header.get("versions", {}).items()
    )
    reported = ", ".join(
        f"{key} {header[key]}"
        for key in ("object", "sensor", "controller", "rig", "seed")
        if key in header
    )
    files = "".join(
        f"<br>{escape(key)} file {escape(file['name'])}, SHA-256 "
        f"{escape(file['sha256'][:16])}\u2026"
        for key, file in header.get("files", {}).items()
    )
    command = f"<p><code>{escape(header['command'])}</code></p>" if header.get("command") else ""
    text = f"{escape(reported)}<br>{escape(versions)}{files}"
    return f"<h2>Origin of the data</h2>{command}<p>{text}</p>"
