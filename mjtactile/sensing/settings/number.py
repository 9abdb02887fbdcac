"""One number with what it is and where it comes from."""

from __future__ import annotations

from dataclasses import field
from typing import Any


def number(default: Any, meaning: str, source: str) -> Any:
    """A field of a frozen settings class; a test asks every field for both texts."""
    return field(default=default, metadata={"meaning": meaning, "source": source})
