"""A handler that raises would end the viewer: every one of ours is guarded."""

from __future__ import annotations

import functools
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any


def guarded(handler: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """Return a handler that passes exceptions to its plugin's `complain`."""

    @functools.wraps(handler)
    def call(self: Any, event: Any) -> Any:
        try:
            return handler(self, event)
        except Exception as error:  # noqa: BLE001  # whatever it is, the session continues
            last = traceback.extract_tb(error.__traceback__)[-1]
            self.complain(
                f"{type(error).__name__}: {error} ({Path(last.filename).name}, line {last.lineno})"
            )
            return None

    return call
