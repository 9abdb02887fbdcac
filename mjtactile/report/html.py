"""Shared parts of HTML reports: self-contained pages that need no network."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from mjtactile.core.flags import Flags
from mjtactile.recording.files import to_json

_STYLE = """body{font:15px/1.45 sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;
color:#222}
table{border-collapse:collapse;margin:.6em 0}
td,th{padding:.15em .7em;text-align:right;border-bottom:1px solid #e6e6e6}
td:first-child,th:first-child,table.text *{text-align:left}
code{background:#f3f3f3;padding:.1em .3em;user-select:all;font-size:13px}img{max-width:100%}"""


def document(title: str, body: Iterable[str], *, style: str = "") -> str:
    """Return an HTML page. `body` and `style` are HTML and CSS, `title` is text."""
    return (
        '<!doctype html><html lang="en"><head><meta '
        f'charset="utf-8"><title>{escape(title)}</title>'
        f"<style>{_STYLE}{style}</style></head><body>" + "\n".join([*body, "</body></html>"]) + "\n"
    )


def table(head: Sequence[str], rows: Iterable[Sequence[Any]], *, text: bool = False) -> str:
    """Return a table of HTML cells with a plain `head`; `text`: all cells left-aligned."""
    body = "".join("<tr>" + "".join(f"<td>{value}</td>" for value in row) + "</tr>" for row in rows)
    first = f"<tr>{''.join(f'<th>{escape(word)}</th>' for word in head)}</tr>" if head else ""
    return f"<table{' class=text' if text else ''}>{first}{body}</table>"


def flag_table(flags: Flags) -> str:
    """Return a table of the flags of a run with their times."""
    rows = [
        [
            escape(kind),
            _nan_if_none(flag.first, ".2f"),
            _nan_if_none(flag.last, ".2f"),
            _nan_if_none(100 * flag.fraction, ".0f"),
            escape(flag),
        ]
        for kind, flag in flags.items()
    ]
    return table(["flag", "first, s", "last, s", "of the time, %", "reason"], rows, text=True)


def _nan_if_none(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else ""


def is_known(value: Any) -> bool:
    """Return True for a value that a page shows."""
    return value not in (None, "") and not (isinstance(value, float) and math.isnan(value))


def script_data(value: Any) -> str:
    """Return the data of the page's scripts; no text in it can end as a script."""
    text = json.dumps(to_json(value), allow_nan=False, separators=(",", ":"))
    safe = text.replace("<", "\\u003c")
    return f'<script type="application/json" id="data">{safe}</script>'


def data_uri(kind: str, content: bytes) -> str:
    """Encode `content` as a data URI of the MIME type `kind`."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
