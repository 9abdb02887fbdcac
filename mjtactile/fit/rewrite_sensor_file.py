"""Sensor file with changed values.

The existing text and its comments are kept. Each changed line gets a comment.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from mjtactile.fit.parameter_info import FittedParameter, digits


def rewrite(text: str, numbers: Sequence[FittedParameter], head: str) -> str:
    """`text` of a sensor file with the values and comments of `numbers`, and `head` as a comment on
    top."""
    lines = text.splitlines()
    for number in numbers:
        section, key = number.field.split(".")
        if number.state == "fitted":
            value = digits(number.value, number.sd)
        else:
            value = f"{number.value:.10g}"
        is_float = any(c in value for c in ".einf")
        _put(lines, section, key, value if is_float else f"{value}.0", number)
    return "\n".join([*(f"# {line}" for line in head.splitlines()), "", *lines]) + "\n"


def _put(lines: list[str], section: str, key: str, value: str, number: FittedParameter) -> None:
    """Change or add one line.

    A value that the recordings do not determine is not added to the file.
    """
    start = next((i for i, line in enumerate(lines) if re.match(rf"\s*\[{section}\]", line)), None)
    is_finite_value = number.state != "not in these recordings"
    if start is None:
        if is_finite_value:
            lines += ["", f"[{section}]", f"{key} = {value}  # {number.comment}"]
        return
    end = next(
        (i for i in range(start + 1, len(lines)) if lines[i].lstrip().startswith("[")), len(lines)
    )
    for i in range(start + 1, end):
        found = re.match(rf"(\s*{key}\s*=\s*)([^#]*?)(\s*#.*)?$", lines[i])
        if found:
            lines[i] = f"{found[1]}{value if is_finite_value else found[2]}  # {number.comment}"
            return
    if is_finite_value:
        while end > start + 1 and not lines[end - 1].strip():
            end -= 1
        lines.insert(end, f"{key} = {value}  # {number.comment}")
