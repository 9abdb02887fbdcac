"""Initial layout of the package's windows between Studio's bars."""

from __future__ import annotations

from typing import Any

from mujoco.studio.dear_imgui import dear_imgui as imgui

RED = imgui.Vec4(0.9, 0.25, 0.2, 1.0)
LEFT = 274  # width of the control windows, px
OPTIONS = 190  # height of the options window, px
# px
_ABOVE = 26
_BELOW = 34
_GAP = 4
_SIZE_MIN = 120  # px


class WindowLayout:
    """Window placement: call `start` for each frame and `place` before each window.

    A window that the user moves keeps its position until the page's size changes.
    """

    def __init__(self) -> None:
        self._size = (0.0, 0.0)
        self._when = int(imgui.Cond.Once)

    def start(self, size: Any) -> None:
        """Set the page's size, px, for the next frame."""
        changed = (size.x, size.y) != self._size
        self._size = (size.x, size.y)
        self._when = int(imgui.Cond.Always if changed else imgui.Cond.Once)

    def place(self, x: int, y: int, width: int, height: int) -> None:
        """Set position and size of the next window, px.

        Negative positions count from the right or from below. A size of zero or less is relative to
        the remaining size.
        """
        across = self._size[0]
        down = self._size[1] - _ABOVE - _BELOW
        left = x if x >= 0 else across + x
        top = _ABOVE + (y if y >= 0 else down + y)
        size = (width if width > 0 else across + width, height if height > 0 else down + height)
        imgui.SetNextWindowPos(imgui.Vec2(max(left, 0), max(top, _ABOVE)), self._when)
        imgui.SetNextWindowSize(
            imgui.Vec2(*(max(length, _SIZE_MIN) for length in size)), self._when
        )


ABOVE_CAMERA = -(OPTIONS + _GAP)  # window height, px, that leaves space for the options window
