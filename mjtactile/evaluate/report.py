"""`report.html`: one file with success rates, failure ranges and the worst episodes."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.fidelity_levels import fidelity_notes
from mjtactile.core.flags import merge_flags, read_flags
from mjtactile.core.scenario import Scenario
from mjtactile.core.task import load_task
from mjtactile.evaluate import svg
from mjtactile.evaluate.episodes import OUTCOMES
from mjtactile.evaluate.parameter_sensitivity import measures
from mjtactile.evaluate.statistics import pair_text, stopped_text, summarise
from mjtactile.evaluate.wilson import Line
from mjtactile.report.html import data_uri, document, table

_STYLE = (
    ".grid{display:flex;flex-wrap:wrap;gap:.8em}.grid "
    "figure{margin:0}figcaption{font-size:13px}"
    ".out{color:#b00020;font-weight:bold}h3{margin-bottom:.2em}"
)
_SHOWN = 12  # maximum number of plots of randomized values that are not folded
_LABELS = {
    "slip_mm": "slip, mm (ground truth)",
    "force_error_N": "force error in the hold, N",
    "peak_to_break_ratio": "peak force over breaking force (ground truth)",
}


def page(
    manifest: Mapping[str, Any],
    lines: Sequence[Line],
    worst: Sequence[Line],
    images: Mapping[str, Path | None],
) -> str:
    """Return the page, with the `worst` episodes and their `images` by episode name."""
    summary = summarise(lines)
    parts = [
        _head(manifest, summary),
        _success(summary),
        _pairs(summary),
        _failures(lines),
        _flags(summary, lines),
        _distributions(lines),
        _parameter_sections(summary),
        _worst(worst, images),
    ]
    title = f"Evaluation: {_words(manifest['options']['controllers'])}"
    return document(title, parts, style=_STYLE)


def _head(manifest: Mapping[str, Any], summary: Mapping[str, Any]) -> str:
    options = manifest["options"]
    controllers = escape(_words(options["controllers"]))
    values = {key: value for key, value in options.items() if key != "scenario"}
    values |= options["scenario"]
    values = {key: value for key, value in values.items() if value not in ("", None, {})}
    settings = ", ".join(f"{key} {_words(value)}" for key, value in values.items())
    versions = ", ".join(f"{name} {version}" for name, version in manifest["versions"].items())
    notes = fidelity_notes(summary).items()
    return (
        f"<h1>{controllers}: {summary['episodes']} episodes</h1>"
        f"<p>{escape(settings)}<br>{escape(versions)}</p>{_criterion(values)}"
        + "".join(f"<p>{name.capitalize()}: {escape(text)}.</p>" for name, text in notes)
    )


def _criterion(options: Mapping[str, Any]) -> str:
    """Return the success criterion of the task; empty if the file of the task is gone."""
    with contextlib.suppress(InputError):
        task = load_task(str(options.get("task", Scenario().task)))
        return f"<p>Success: {escape(task.success.text)}.</p>"
    return ""


def _words(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


def _success(summary: Mapping[str, Any]) -> str:
    rows = []
    for s, (name, mine) in enumerate(summary["controllers"].items()):
        for label, group in (("all", mine), *mine["objects"].items()):
            low, high = group["success_interval"]
            is_rated = group["episodes"] > group["error"]
            rate = group["success"] if is_rated else 0.0
            rows.append(
                {
                    "controller": escape(name),
                    "object": escape(label),
                    "episodes": group["episodes"],
                    "held": f"{100 * rate:.1f} %" if is_rated else "-",
                    "95 % (Wilson)": f"{100 * low:.1f}-{100 * high:.1f} %",
                    "": svg.interval_bar(low, rate, high, svg.colour(s)),
                    "dropped": group["dropped"],
                    "crushed": group["crushed"],
                    "stopped": stopped_text(group),
                    "errors": group["error"],
                }
            )
    head = list(rows[0]) if rows else []
    return (
        f"<h2>Success</h2>{table(head, [list(row.values()) for row in rows])}"
        "<p>Stopped: the supervisor moved the gripper to its safe state, or the controller "
        "hung or raised. Errors are not the controller's fault, and are not in the success "
        "rates.</p>"
    )


def _pairs(summary: Mapping[str, Any]) -> str:
    if not summary["paired"]:
        return ""
    items = "".join(f"<li>{escape(pair_text(pair))}</li>" for pair in summary["paired"])
    return f"<h2>Comparison on the same episodes</h2><ul>{items}</ul>"


def _failures(lines: Sequence[Line]) -> str:
    """Return the failures, grouped by similar reasons."""
    kinds: dict[tuple[str, ...], list[Line]] = {}
    for line in lines:
        if line["outcome"] != "held":
            reason = re.sub(r"-?\d[\d.e+-]*", "#", line["reason"] or "")
            kind = line["controller"], line["object"], line["outcome"], line.get("phases", "")
            kinds.setdefault((*kind, reason), []).append(line)
    if not kinds:
        return "<h2>Failures and errors</h2><p>None.</p>"
    rows = [
        [
            *map(escape, key[:4]),
            escape(group[0]["reason"] or ""),
            len(group),
            f"<code>{escape(group[0]['rerun_command'])}</code>",
        ]
        for key, group in sorted(kinds.items(), key=lambda item: -len(item[1]))
    ]
    head = ["controller", "object", "outcome", "phases", "reason (of the first)"]
    head += ["episodes", "rerun of the first"]
    return "<h2>Failures and errors</h2>" + table(head, rows, text=True)


def _flags(summary: Mapping[str, Any], lines: Sequence[Line]) -> str:
    """Return the outcomes with and without each flag of reduced simulation accuracy."""
    reasons = merge_flags(read_flags(line.get("flags", {})) for line in lines)
    rows = []
    for name, mine in summary["controllers"].items():
        for kind, groups in mine["flags"].items():
            outcomes = [_outcomes(groups["with"]), _outcomes(groups["without"])]
            reason = escape(reasons.get(kind, ""))
            episodes = groups["with"]["episodes"]
            rows.append([escape(name), escape(kind), episodes, *outcomes, reason])
    title = "<h2>Flags of reduced simulation accuracy</h2>"
    if not rows:
        return title + "<p>Nothing.</p>"
    head = ["controller", "flag", "episodes", "with it", "without it", "reason (of the first)"]
    return title + table(head, rows, text=True)


def _outcomes(group: Mapping[str, Any]) -> str:
    counts = ", ".join(f"{group[name]} {name}" for name in OUTCOMES if group[name])
    low, high = group["success_interval"]
    rate = f"; {100 * low:.0f}-{100 * high:.0f} %" if group["episodes"] > group["error"] else ""
    return (counts or "none") + rate


def _distributions(lines: Sequence[Line]) -> str:
    names = list(dict.fromkeys(line["controller"] for line in lines))
    figures = []
    for measure, label in _LABELS.items():
        series: dict[str, list[float]] = {name: [] for name in names}
        for line in lines:
            value = measures(line)[measure]
            if value is not None:
                series[line["controller"]].append(value)
        marks = [(1.0, "breaks")] if measure == "peak_to_break_ratio" else []
        caption = "<br>".join(_quantiles(*item) for item in series.items())
        figures.append(_figure(svg.histogram(series, label, marks), caption))
    return "<h2>Distributions</h2>" + _legend(names) + _grid(figures)


def _quantiles(name: str, values: Sequence[float]) -> str:
    if not values:
        return f"{escape(name)}: -"
    median, high, maximum = np.quantile(values, (0.5, 0.95, 1.0))
    return f"{escape(name)}: median {median:.3g}, 95 % below {high:.3g}, maximum {maximum:.3g}"


def _parameter_sections(summary: Mapping[str, Any]) -> str:
    """Plot the success rate over each randomized value, in the order of the first controller."""
    controllers = summary["controllers"]
    by_value: dict[str, dict[str, Any]] = {}
    for name, group in controllers.items():
        for result in group["randomized"]:
            by_value.setdefault(result["name"], {})[name] = result
    figures = []
    even = []
    for value, results in by_value.items():
        labels = list(dict.fromkeys(_bin(b) for result in results.values() for b in result["bins"]))
        series = {name: [_point(own, label) for label in labels] for name, own in results.items()}
        points = [point for own in series.values() for point in own if point is not None]
        is_even = all(success == 1.0 for _, success, _ in points)
        chosen = even if is_even else figures
        chosen.append(_figure(svg.fractions(labels, series), _caption(value, results)))
    title = "<h2>Success against randomized values</h2>"
    if not (figures or even):
        return f"{title}<p>Nothing was randomized.</p>"
    more = ""
    if len(figures) > _SHOWN:
        summary_text = f"<summary>{len(figures) - _SHOWN} more</summary>"
        more = f"<details>{summary_text}{_grid(figures[_SHOWN:])}</details>"
    if even:
        summary_text = f"<summary>{len(even)} values with 100 % success in each bin</summary>"
        more += f"<details>{summary_text}{_grid(even)}</details>"
    return f"{title}{_SENSITIVITY_NOTE}{_legend(list(controllers))}{_grid(figures[:_SHOWN])}{more}"


_SENSITIVITY_NOTE = """<p>
Each bin has the same number of episodes and is labeled with its center; intervals are 95 %.
p: probability that chance alone separates failures from successes at least this far, in the
value or (both ways) in its distance from the center (Mann and Whitney). Values below 5 %, shared
by all values, stand out. rho: rank correlation with slip, force error in the hold and fraction of
the breaking force, which grow before a failure. Values most related to failures come first.</p>"""


def _grid(figures: Iterable[str]) -> str:
    return f'<div class="grid">{"".join(figures)}</div>'


_SHORT = {"slip_mm": "slip", "force_error_N": "force", "peak_to_break_ratio": "peak"}


def _caption(value: str, results: Mapping[str, Mapping[str, Any]]) -> str:
    parts = [f"<b>{escape(value)}</b>"]
    for name, result in results.items():
        facts = []
        if result["p"] is not None:
            facts = [f"p = {result['p']:.2g}{' (both ways)' if result['both_ways'] else ''}"]
        correlations = {short: result["correlation"].get(key, 0.0) for key, short in _SHORT.items()}
        facts += [f"rho {short} {r:+.2f}" for short, r in correlations.items() if abs(r) > 0.2]
        text = (f"{escape(name)}: " if len(results) > 1 else "") + ", ".join(facts)
        stands_out = result["stands_out"]
        parts.append(f'<span class="out">{text}: stands out</span>' if stands_out else text)
    return "<br>".join(part for part in parts if part)


def _bin(group: Mapping[str, Any]) -> str:
    if "value" not in group:
        return f"{(group['from'] + group['to']) / 2:.2g}"
    value = group["value"]
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _point(result: Mapping[str, Any], label: str) -> tuple[float, float, float] | None:
    for group in result["bins"]:
        if _bin(group) == label:
            low, high = group["success_interval"]
            return low, group["success"], high
    return None


def _worst(worst: Iterable[Line], images: Mapping[str, Path | None]) -> str:
    parts = [
        "<h2>The worst episodes</h2><p>Failures first (the kinds in turn), then errors, then "
        "the episodes closest to a failure by force or slip.</p>"
    ]
    for line in worst:
        values = {label: measures(line)[measure] for measure, label in _LABELS.items()}
        facts = [f"{label} {value:.3g}" for label, value in values.items() if value is not None]
        facts += [escape(line["reason"])] if line["reason"] else []
        parts.append(
            f"<h3>{escape(line['controller'])}, {escape(line['object'])}, seed {line['seed']}: "
            f"{line['outcome']}</h3>"
            f"<p>{'; '.join(facts)}<br>{escape(line.get('phases', ''))}<br>"
            f"<code>{escape(line['rerun_command'])}</code></p>"
        )
        image = images.get(f"{line['controller']}-{line['episode']:06d}")
        if image is not None:
            uri = data_uri("image/png", image.read_bytes())
            parts.append(f'<img alt="scene, camera images, surfaces and forces" src="{uri}">')
        sampled = ", ".join(f"{name} {value}" for name, value in line.get("randomized", {}).items())
        if sampled:
            title = "<summary>sampled values</summary>"
            parts.append(f"<details>{title}<p>{escape(sampled)}</p></details>")
    return "\n".join(parts)


def _legend(names: Sequence[str]) -> str:
    if len(names) < 2:
        return ""
    items = (
        f'<span style="color:{svg.colour(k)}">&#9632; {escape(name)}</span>'
        for k, name in enumerate(names)
    )
    return f"<p>{' '.join(items)}</p>"


def _figure(chart: str, caption: str) -> str:
    return f"<figure>{chart}<figcaption>{caption}</figcaption></figure>"
