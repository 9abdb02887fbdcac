"""Destination of MuJoCo's own warnings. By default MuJoCo writes MUJOCO_LOG.TXT into the current
working folder."""

from __future__ import annotations

import logging

import mujoco

_logger = logging.getLogger("mjtactile.mujoco")


def route_warnings() -> None:
    """Send MuJoCo's warnings to Python's logging instead of a file, for the whole process."""
    mujoco.set_mju_user_warning(_logger.warning)
