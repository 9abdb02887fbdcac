"""Where MuJoCo's own warnings go. By default it writes MUJOCO_LOG.TXT into the working folder,
whatever that is."""

from __future__ import annotations

import logging

import mujoco

_logger = logging.getLogger("mjtactile.mujoco")


def route_warnings() -> None:
    """Send MuJoCo's warnings to Python's logging, and nothing to a file. Holds for the whole
    process."""
    mujoco.set_mju_user_warning(_logger.warning)
