"""`NotCopyable`: base of objects that share memory with a simulation or a device."""

from __future__ import annotations

from typing import Any, NoReturn, SupportsIndex

from mjtactile.core.errors import InputError


class NotCopyable:
    """Base of objects that cannot be copied or pickled: a copy would write to the same memory.

    `copy.copy`, `copy.deepcopy` and `pickle` raise InputError. `REMEDY` is the next action.
    """

    REMEDY = "create another one"

    def __reduce_ex__(self, protocol: SupportsIndex) -> NoReturn:
        raise InputError(
            f"cannot be copied or pickled, since it shares memory with its simulation: "
            f"{self.REMEDY}",
            source=type(self).__name__,
        )

    def __deepcopy__(self, memo: Any) -> NoReturn:
        self.__reduce_ex__(4)
