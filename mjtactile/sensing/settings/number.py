"""One number with what it is and where it comes from."""

from __future__ import annotations

from dataclasses import astuple, field
from functools import lru_cache
from typing import Any

import numpy as np


def number(default: Any, meaning: str, source: str) -> Any:
    """A field of a frozen settings class; a test asks every field for both texts."""
    return field(default=default, metadata={"meaning": meaning, "source": source})


@lru_cache(maxsize=64)
def as_numbers(settings: Any) -> np.ndarray:
    """A settings class of plain numbers as the kernels take it: one a field, in their order."""
    array = np.array(astuple(settings), float)
    array.flags.writeable = False
    return array
