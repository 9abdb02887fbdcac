"""`report.html`: one file with success rates, failure ranges and the worst episodes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.fidelity_levels import fidelity_notes
from mjtactile.core.flags import merge_flags, read_flags
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
_SHOWN = 12  # drawings of varied values before the rest is folded away
_LABELS = {
    "slip_mm": "slip, mm (ground truth)",
    "force_error_N": "force error in the hold, N",
    "peak_to_break_ratio": "peak force over breaking force (ground truth)",
}


def page(
    manifest: Mapping[str, Any],
    lines: Sequence[Line],
    worst: Sequence[Line],
    pictures: Mapping[str, Path | None],
) -> str:
    """Return the page. It shows the `worst` episodes with their `pictures`, by controller and
    episode number."""
    summary = summarise(lines)
    parts = [
        _head(manifest, summary),
        _success(summary),
        _pairs(summary),
        _failures(lines),
        _flags(summary, lines),
        _distributions(lines),
        _varied(summary),
        _worst(worst, pictures),
    ]
    return document(
        f"Evaluation: {_words(manifest['options']['controllers'])}", parts, style=_STYLE
    )


def _head(manifest: Mapping[str, Any], summary: Mapping[str, Any]) -> str:
    options = manifest["options"]
    controllers = escape(_words(options["controllers"]))
    values = {key: value for key, value in options.items() if key != "scenario"}
    values |= options["scenario"]
    said = ", ".join(
        f"{key} {_words(value)}" for key, value in values.items() if value not in ("", None, {})
    )
    versions = ", ".join(f"{name} {version}" for name, version in manifest["versions"].items())
    return (
        f"<h1>{controllers}: {summary['episodes']} episodes</h1>"
        f"<p>{escape(said)}<br>{escape(versions)}</p>"
        + "".join(
            f"<p>{name.capitalize()}: {escape(text)}.</p>"
            for name, text in fidelity_notes(summary).items()
        )
    )


def _words(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


def _success(summary: Mapping[str, Any]) -> str:
    rows = []
    for s, (name, mine) in enumerate(summary["controllers"].items()):
        for label, group in (("all", mine), *mine["objects"].items()):
            low, high = group["success_interval"]
            ended = group["episodes"] > group["error"]
            share = group["success"] if ended else 0.0
            colour = svg.COLOURS[s % len(svg.COLOURS)]
            rows.append(
                [
                    escape(name),
                    escape(label),
                    group["episodes"],
                    f"{100 * share:.1f} %" if ended else "-",
                    f"{100 * low:.1f}-{100 * high:.1f} %",
                    svg.interval_bar(low, share, high, colour),
                    group["dropped"],
                    group["crushed"],
                    stopped_text(group),
                    group["error"],
                ]
            )
    head = [
        "controller",
        "object",
        "episodes",
        "held",
        "95 % (Wilson)",
        "",
        "dropped",
        "crushed",
        "stopped",
        "errors",
    ]
    return (
        "<h2>Success</h2>"
        + table(head, rows)
        + (
            "<p>Stopped: the supervisor moved the gripper to its safe state, or the controller "
            "hung or raised. Errors are not the controller's fault, and are not in the success "
            "rates.</p>"
        )
    )


def _pairs(summary: Mapping[str, Any]) -> str:
    if not summary["paired"]:
        return ""
    return (
        "<h2>Comparison on the same episodes</h2><ul>"
        + "".join(f"<li>{escape(pair_text(pair))}</li>" for pair in summary["paired"])
        + "</ul>"
    )


def _failures(lines: Sequence[Line]) -> str:
    """Return the failures, grouped by similar reasons."""
    kinds: dict[tuple[str, ...], list[Line]] = {}
    for line in lines:
        if line["outcome"] != "held":
            reason = re.sub(r"-?\d[\d.e+-]*", "#", line["reason"] or "")
            kind = (
                line["controller"],
                line["object"],
                line["outcome"],
                line.get("phases", ""),
                reason,
            )
            kinds.setdefault(kind, []).append(line)
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
    return "<h2>Failures and errors</h2>" + table(
        [
            "controller",
            "object",
            "outcome",
            "phases",
            "reason (of the first)",
            "episodes",
            "rerun of the first",
        ],
        rows,
        text=True,
    )


def _flags(summary: Mapping[str, Any], lines: Sequence[Line]) -> str:
    """Return the episodes by flag of reduced simulation accuracy, with outcomes with and without
    it."""
    reasons = merge_flags(read_flags(line.get("flags", {})) for line in lines)
    rows = []
    for name, mine in summary["controllers"].items():
        for kind, one in mine["flags"].items():
            episodes = one["with"]["episodes"]
            reason = escape(reasons.get(kind, ""))
            went = [_went(one["with"]), _went(one["without"])]
            rows.append([escape(name), escape(kind), episodes, *went, reason])
    title = "<h2>Flags of reduced simulation accuracy</h2>"
    if not rows:
        return title + "<p>Nothing.</p>"
    head = ["controller", "doubt", "episodes", "with it", "without it", "reason (of the first)"]
    return title + table(head, rows, text=True)


def _went(group: Mapping[str, Any]) -> str:
    """The outcomes of some episodes in words."""
    counts = {name: group[name] for name in OUTCOMES if group[name]}
    low, high = group["success_interval"]
    share = f"; {100 * low:.0f}-{100 * high:.0f} %" if group["episodes"] > group["error"] else ""
    return (", ".join(f"{count} {name}" for name, count in counts.items()) or "none") + share


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
        figures.append(
            _figure(
                svg.histogram(series, label, marks),
                "<br>".join(_quantiles(*one) for one in series.items()),
            )
        )
    return "<h2>Distributions</h2>" + _legend(names) + _grid(figures)


def _quantiles(name: str, values: Sequence[float]) -> str:
    if not values:
        return f"{escape(name)}: -"
    middle, maximum, high = (float(np.quantile(values, share)) for share in (0.5, 1.0, 0.95))
    return f"{escape(name)}: median {middle:.3g}, 95 % below {high:.3g}, maximum {maximum:.3g}"


def _varied(summary: Mapping[str, Any]) -> str:
    """Success against each varied value; the order is that of the first controller."""
    controllers = summary["controllers"]
    order = [one["name"] for mine in controllers.values() for one in mine["randomized"]]
    found = {
        name: {one["name"]: one for one in mine["randomized"]} for name, mine in controllers.items()
    }
    figures = []
    for value in dict.fromkeys(order):
        mine = {name: own[value] for name, own in found.items() if value in own}
        labels = list(dict.fromkeys(_bin(one) for own in mine.values() for one in own["bins"]))
        series = {name: [_point(own, label) for label in labels] for name, own in mine.items()}
        figures.append(_figure(svg.shares(labels, series), _caption(value, mine)))
    if not figures:
        return "<h2>Success against randomized values</h2><p>Nothing was randomized.</p>"
    if len(figures) > _SHOWN:
        rest = (
            f"<details><summary>{len(figures) - _SHOWN} "
            f"more</summary>{_grid(figures[_SHOWN:])}</details>"
        )
    else:
        rest = ""
    return (
        "<h2>Success against randomized "
        f"values</h2>{_HOW_VARIED}{_legend(list(controllers))}{_grid(figures[:_SHOWN])}{rest}"
    )


_HOW_VARIED = """<p>
Each bin has the same number of episodes and is labeled with its center; intervals are 95 %.
p: probability that chance alone separates failures from successes at least this far, in the
value or (both ways) in its distance from the center (Mann and Whitney). Values below 5 %, shared
by all values, stand out. rho: rank correlation with slip, force error in the hold and fraction of
the breaking force, which grow before a failure. Values most related to failures come first.</p>"""


def _grid(figures: Iterable[str]) -> str:
    return f'<div class="grid">{"".join(figures)}</div>'


def _caption(value: str, mine: Mapping[str, Mapping[str, Any]]) -> str:
    parts = [f"<b>{escape(value)}</b>"]
    for name, one in mine.items():
        if one["p"] is None:
            said = []
        else:
            said = [f"p = {one['p']:.2g}{' (both ways)' if one['both_ways'] else ''}"]
        said += [
            f"rho {short} {one['correlation'][measure]:+.2f}"
            for measure, short in (
                ("slip_mm", "slip"),
                ("force_error_N", "force"),
                ("peak_to_break_ratio", "peak"),
            )
            if abs(one["correlation"].get(measure, 0.0)) > 0.2
        ]
        text = (f"{escape(name)}: " if len(mine) > 1 else "") + ", ".join(said)
        parts.append(f'<span class="out">{text}: stands out</span>' if one["stands_out"] else text)
    return "<br>".join(part for part in parts if part)


def _bin(one: Mapping[str, Any]) -> str:
    if "value" in one:
        if isinstance(one["value"], float):
            return f"{one['value']:.3g}"
        return str(one["value"])
    return f"{(one['from'] + one['to']) / 2:.2g}"


def _point(own: Mapping[str, Any], label: str) -> tuple[float, float, float] | None:
    one = next((one for one in own["bins"] if _bin(one) == label), None)
    if one is None:
        return None
    return (one["success_interval"][0], one["success"], one["success_interval"][1])


def _worst(worst: Iterable[Line], pictures: Mapping[str, Path | None]) -> str:
    parts = [
        "<h2>The worst episodes</h2><p>Failures first (the kinds in turn), then errors, then "
        "the episodes closest to a failure by force or slip.</p>"
    ]
    for line in worst:
        found = measures(line)
        facts = [
            f"{label} {value:.3g}"
            for measure, label in _LABELS.items()
            if (value := found[measure]) is not None
        ]
        facts += [escape(line["reason"])] if line["reason"] else []
        parts.append(
            f"<h3>{escape(line['controller'])}, {escape(line['object'])}, seed {line['seed']}: "
            f"{line['outcome']}</h3>"
            f"<p>{'; '.join(facts)}<br>{escape(line.get('phases', ''))}<br>"
            f"<code>{escape(line['rerun_command'])}</code></p>"
        )
        picture = pictures.get(f"{line['controller']}-{line['episode']:06d}")
        if picture is not None:
            uri = data_uri("image/png", picture.read_bytes())
            parts.append(f'<img alt="scene, camera images, surfaces and forces" src="{uri}">')
        drawn = ", ".join(f"{name} {value}" for name, value in line.get("randomized", {}).items())
        if drawn:
            parts.append(
                f"<details><summary>sampled values</summary><p>{escape(drawn)}</p></details>"
            )
    return "\n".join(parts)


def _legend(names: Sequence[str]) -> str:
    if len(names) < 2:
        return ""
    return (
        "<p>"
        + " ".join(
            f'<span style="color:{svg.COLOURS[k % len(svg.COLOURS)]}">&#9632; {escape(name)}</span>'
            for k, name in enumerate(names)
        )
        + "</p>"
    )


def _figure(drawing: str, caption: str) -> str:
    return f"<figure>{drawing}<figcaption>{caption}</figcaption></figure>"
