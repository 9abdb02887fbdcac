"""Destination of MuJoCo's own warnings, which otherwise go to MUJOCO_LOG.TXT."""

from __future__ import annotations

import logging

import mujoco

_logger = logging.getLogger("mjtactile.mujoco")


def route_warnings() -> None:
    """Send MuJoCo's warnings to Python's logging instead of a file, for the whole process."""
    mujoco.set_mju_user_warning(_logger.warning)
