"""What `mjtactile doctor` says of a rig: findings in plain words, each with a remedy."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """`level` "ok", "warn" or "bad"; `what` was looked at, `text` what was found, `remedy` how to
    mend it ("": nothing to)."""

    level: str
    what: str
    text: str
    remedy: str = ""
