"""Simulated operator of an emulated rig, with a printed board, a caliper, a load cell and a
keyboard.

The emulator's world serves as caliper and load cell, as in `mjtactile.calibrate.interactive`. These
instruments are outside of the devices, and a person would read them on a real rig.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mjtactile.calibrate.camera import Board
from mjtactile.core.design import CameraDesign

BOARD = Board(9, 7, 5e-3, 3.75e-3)
_PIXELS = 60  # per square of the rendered board


class Person:
    """Replacement for stdin and stderr: reads the prompt, reads the instrument, types the
    answer."""

    def __init__(self, emulator: Any):
        self._emulator = emulator
        self._question = ""
        self.read: list[str] = []

    def write(self, text: str) -> None:
        self.read.append(text)
        self._question = text if text.strip() else self._question

    def flush(self) -> None:
        pass

    def isatty(self) -> bool:
        return True

    def fileno(self) -> int:
        return sys.__stderr__.fileno()  # type: ignore[union-attr]

    def readline(self) -> str:
        truth = self._emulator.truth()
        if "force limit" in self._question:
            return f"{(truth['contact_1'] + truth['contact_2']) / 2:.3f}\n"
        if (
            "currents report" in self._question
        ):  # soft membranes, not inflated: their frames carry a part
            return f"{truth['grip_force']:.3f}\n"
        if "caliper" in self._question:
            return f"{1e3 * truth['opening']:.2f}\n"
        return "\n"

    @contextlib.contextmanager
    def at_the_terminal(self) -> Iterator[None]:
        """Answer prompts on stderr through stdin while the context lasts."""
        before = sys.stdin, sys.stderr
        sys.stdin = sys.stderr = self  # type: ignore[assignment]
        try:
            yield
        finally:
            sys.stdin, sys.stderr = before


def photograph_board(folder: Path, camera: CameraDesign) -> None:
    """Write images of the board, tilted and distributed over the view.

    They use OpenCV's model of that camera, without membrane and glass.
    """
    K = camera.K
    k = np.array(camera.distortion)
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
    points = cv2.undistortPoints(np.stack([u.ravel(), v.ravel()], axis=1), K, k, criteria=criteria)
    rays = np.concatenate([points.reshape(*u.shape, 2), np.ones((*u.shape, 1))], axis=2)
    sampled = cv2.GaussianBlur(BOARD.render(_PIXELS), (0, 0), 1.5)
    rng = np.random.default_rng(5)
    folder.mkdir()
    for i in range(12):
        rotation = np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(-0.3, 0.3)])
        depth = rng.uniform(0.045, 0.065)
        R = cv2.Rodrigues(rotation)[0]
        aim = np.array([(-1, 1)[i % 2] * 0.16, (-1, 1)[i // 2 % 2] * 0.13, 1.0]) * depth
        corner = aim - R @ np.array([BOARD.columns, BOARD.rows, 0]) * BOARD.square / 2
        at = rays @ np.linalg.inv(np.column_stack([R[:, 0], R[:, 1], corner])).T
        at = (at[..., :2] / at[..., 2:] * _PIXELS / BOARD.square + _PIXELS / 2 - 0.5).astype(
            np.float32
        )
        gray = cv2.remap(sampled, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=255)
        gray = cv2.GaussianBlur(gray, (0, 0), 0.7) * 0.7 + 30 + rng.normal(0, 2.0, gray.shape)
        cv2.imwrite(str(folder / f"{i:02d}.png"), np.clip(gray, 0, 255).astype(np.uint8))
