"""Images of two cross sections of a contact shape: along its smaller curvature and across it.

In simulation they also show the ground truth.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, ContactShape
from mjtactile.report.shape_wireframe import describe_shape, directions_of, lines_of

_RADIUS = 9e-3  # half-width of a section, m
_ESTIMATED = (25, 25, 25)  # blue, green, red
_TRUE = (0, 123, 224)
_PAPER = (255, 255, 255)
_TEXT = 24  # px of the line above
_NAMES = ("along", "across")


def plot_section(
    shape: ContactShape | None, true: Array, size: tuple[int, int]
) -> NDArray[np.uint8]:
    """Plot two cross sections side by side, with heights to scale.

    Args:
        shape: The estimated contact shape, or None.
        true: Segments (n, 2, 3), m, in S, of the ground truth (`shape_wireframe.true_lines`).
        size: Height and width, px.

    Returns:
        Blue, green, red (*size, 3).
    """
    image = np.full((*size, 3), _PAPER, np.uint8)
    if shape is None:
        _write(image, "no known contact shape", (8, 17))
        return image
    text = f"{describe_shape(shape)}; estimated black" + (
        ", ground truth orange" if len(true) else ""
    )
    _write(image, text, (8, 17))
    half = size[1] // 2
    arcs = lines_of(shape)[-2:]
    for index, (angle, arc) in enumerate(zip(directions_of(shape), arcs, strict=False)):
        panel = image[_TEXT:, index * half : (index + 1) * half]
        direction = np.array([np.cos(angle), np.sin(angle)])
        across = np.array([-direction[1], direction[0]])
        offset = true - shape.p_SO
        section = offset[(np.abs(offset[:, :, :2] @ across) < 1e-9).all(axis=1)]
        _render(panel, [_flat(piece, direction) for piece in section], _TRUE, 3)
        _render(panel, [_flat(arc - shape.p_SO, direction)], _ESTIMATED, 1)
        _write(panel, _NAMES[index], (8, panel.shape[0] - 8))
    return image


def _flat(points: Array, way: Array) -> Array:
    """Project points to the section plane: (n, 2), m, along the section and up."""
    return np.column_stack([points[:, :2] @ way, points[:, 2]])


def _render(
    panel: NDArray[np.uint8], lines: list[Array], colour: tuple[int, ...], wide: int
) -> None:
    scale = panel.shape[1] / (2 * _RADIUS)
    foot = panel.shape[0] - 0.15 * panel.shape[0]
    for line in lines:
        pixels = np.column_stack(
            [panel.shape[1] / 2 + scale * line[:, 0], foot - scale * line[:, 1]]
        )
        points = np.round(16 * pixels).astype(np.int32)
        own = np.ascontiguousarray(panel)
        cv2.polylines(own, [points], False, colour, wide, cv2.LINE_AA, shift=4)
        panel[:] = own


def _write(image: NDArray[np.uint8], text: str, at: tuple[int, int]) -> None:
    own = np.ascontiguousarray(image)
    cv2.putText(own, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.45, _ESTIMATED, 1, cv2.LINE_AA)
    image[:] = own
