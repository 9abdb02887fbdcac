"""Findings of `mjtactile doctor` about a rig in plain text, each with a remedy."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Result of one check.

    `level` is "ok", "warn" or "bad". `subject` names the checked item, `text` is the result,
    `remedy` the repair ("": none needed).
    """

    level: str
    subject: str
    text: str
    remedy: str = ""
