"""Sensor file with changed values.

The existing text and its comments are kept. Each changed line gets a comment.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from mjtactile.fit.parameter_info import FittedParameter, digits


def rewrite(text: str, parameters: Sequence[FittedParameter], head: str) -> str:
    """Return the sensor file `text` with the values and comments of `parameters`, and `head` as a
    comment on top."""
    lines = text.splitlines()
    for parameter in parameters:
        section, key = parameter.field.split(".")
        if parameter.state == "fitted":
            value = digits(parameter.value, parameter.sd)
        else:
            value = f"{parameter.value:.10g}"
        is_float = any(c in value for c in ".einf")
        _set_line(lines, section, key, value if is_float else f"{value}.0", parameter)
    return "\n".join([*(f"# {line}" for line in head.splitlines()), "", *lines]) + "\n"


def _set_line(
    lines: list[str], section: str, key: str, value: str, parameter: FittedParameter
) -> None:
    """Change or add one line.

    A value that the recordings do not determine is not added to the file.
    """
    start = next((i for i, line in enumerate(lines) if re.match(rf"\s*\[{section}\]", line)), None)
    is_finite_value = parameter.state != "not in these recordings"
    if start is None:
        if is_finite_value:
            lines += ["", f"[{section}]", f"{key} = {value}  # {parameter.comment}"]
        return
    end = next(
        (i for i in range(start + 1, len(lines)) if lines[i].lstrip().startswith("[")), len(lines)
    )
    for i in range(start + 1, end):
        found = re.match(rf"(\s*{key}\s*=\s*)([^#]*?)(\s*#.*)?$", lines[i])
        if found:
            lines[i] = f"{found[1]}{value if is_finite_value else found[2]}  # {parameter.comment}"
            return
    if is_finite_value:
        while end > start + 1 and not lines[end - 1].strip():
            end -= 1
        lines.insert(end, f"{key} = {value}  # {parameter.comment}")
