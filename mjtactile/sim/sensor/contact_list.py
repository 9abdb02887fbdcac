"""Memory layout of MuJoCo's contact list, for kernels that read it in place without copies."""

from __future__ import annotations

import ctypes

import mujoco
import numpy as np
from numpy.typing import NDArray

# as in kernels/membrane_flex.c
_FIELDS = ("dist", "includemargin", "frame", "friction", "dim", "geom", "flex", "efc_address")
_layout = np.zeros(1 + len(_FIELDS), np.int64)


def listed(data: mujoco.MjData) -> tuple[int, int, NDArray[np.int64]]:
    """Return the number of contacts, the address of the first one's `dist`, and byte offsets.

    The offsets are those from one contact to the next, and from `dist` to each of `_FIELDS`. The
    result is valid until the next step.
    """
    contact = data.contact
    dist = contact.dist
    if not len(dist):
        return 0, 0, _layout
    if not _layout[0]:  # the same for all models
        _layout[0] = dist.strides[0]
        _layout[1:] = [_address(getattr(contact, name)) - _address(dist) for name in _FIELDS]
    return len(dist), ctypes.addressof(ctypes.c_char.from_buffer(dist[:1])), _layout  # type: ignore[arg-type]


def _address(column: NDArray) -> int:
    return column.__array_interface__["data"][0]
