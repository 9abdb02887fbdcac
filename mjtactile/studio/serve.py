"""Consecutive runs, and the Studio that displays them.

Studio opens in the browser or in a separate window.
"""

from __future__ import annotations

import importlib
import math
import os
import socket
import sys
import threading
import time
from dataclasses import replace
from typing import Any

from mujoco.studio import app, viewer_handle, viewer_protocol

from mjtactile.core import signals
from mjtactile.core.errors import InputError, Interrupted, MjtactileError
from mjtactile.core.loopback import LOOPBACK
from mjtactile.core.scenario import Scenario
from mjtactile.rig.registry import SIMULATES, request_of
from mjtactile.runtime.controller import load_controller
from mjtactile.runtime.grasp import run_grasp
from mjtactile.sim.scenes.objects import load_object
from mjtactile.studio.control_window import ControlWindow
from mjtactile.studio.local_server import checked_at, launch
from mjtactile.studio.panel import Panel
from mjtactile.studio.playback import PlaybackWindow, RecordingPlayer
from mjtactile.studio.session_bridge import RestartRequested, SessionBridge
from mjtactile.studio.state_sync import StateSync

_PERIOD = 0.005  # period of the session's checks, s
# thread switch interval, s: sensing releases the interpreter for each kernel, and waited up to 5 ms
# for the windows each time
_SWITCH_INTERVAL = 1e-4
_EVERY = 0.05  # maximum period between transmitted states without a change, s


def launch_window(
    config: viewer_protocol.ViewerConfig, plugins: list[Any]
) -> viewer_handle.ViewerHandle:
    """Call `launch_native.launch`. Raises MjtactileError without a display or graphics."""
    instead = "omit --native, and open the printed address"
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise MjtactileError(
            f"--native: no display is available (DISPLAY, WAYLAND_DISPLAY): {instead}"
        )
    try:
        # import here, so that missing libraries raise an error in this thread
        importlib.import_module("mujoco.studio.native_viewer")
        from mujoco.studio import launch_native
    except (ImportError, OSError) as error:
        raise MjtactileError(
            f"--native: MuJoCo's own window does not work here ({error}): {instead}"
        ) from error
    return launch_native.launch(config, plugins=plugins)


def watch(
    bridge: SessionBridge,
    *,
    port: int = 0,
    browser: bool = True,
    native: bool = False,
    runs: int = 0,
    wait: bool = False,
) -> None:
    """Run and display grasps until the viewer is closed or Ctrl-C is pressed.

    `runs` is the maximum number of runs. With `wait` the first run starts when a page is open.

    Raises the exceptions of `run_grasp` in the first run. Later ones are shown in the panel, which
    continues. Raises InputError if the port is in use, and MjtactileError if the viewer fails.
    """
    config = viewer_protocol.ViewerConfig(
        title=f"mjtactile: {bridge.scenario.object}",
        http_port=port,
        open_browser=browser,
        gfx="" if native else "web",
    )
    if not native:
        require_free_port(port)
    if not isinstance(bridge, RecordingPlayer):
        _require_valid(bridge.scenario)
    mirror = StateSync(bridge)
    studio_app = app.App(app.Config(show_options=False, show_inspector=False))
    desk = PlaybackWindow(bridge) if isinstance(bridge, RecordingPlayer) else ControlWindow(bridge)
    plugins = [studio_app, desk, Panel(bridge), mirror]
    handle = launch_window(config, plugins) if native else launch(config, plugins=plugins)
    errors: list[str] = []
    studio = threading.Thread(
        target=_sync, args=(handle, mirror, bridge, errors), name="studio", daemon=True
    )
    studio.start()
    before = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL)
    try:
        if wait and not native:
            _wait_for_page(bridge)
        while not bridge.closed.is_set():
            bridge.restart.clear()
            _run(bridge)
            if runs and bridge.runs >= runs:
                return
            while not (bridge.restart.wait(0.1) or bridge.closed.is_set()):
                pass
    finally:
        bridge.closed.set()
        studio.join(5.0)
        sys.setswitchinterval(before)
    if errors:
        raise MjtactileError(f"Studio ended: {errors[0]}")


def require_free_port(port: int) -> None:
    """Raise InputError if the port of the page is in use; 0, any port, is free."""
    try:
        socket.create_server((LOOPBACK, port)).close()
    except OSError as error:
        message = f"port {port} is not available: {error.strerror}"
        choices = ["another port", "no --port: the first free one"]
        raise InputError(message, field="--port", choices=choices) from error


def _require_valid(scenario: Scenario) -> None:
    """Raise InputError for a wrong name or file, before the page is waited for."""
    load_controller(scenario.controller)
    kind, _ = request_of(scenario)
    if kind in SIMULATES:
        load_object(scenario.object)


def _wait_for_page(bridge: SessionBridge) -> None:
    """Wait until a page is open, so that its user sees the whole run. Raises Interrupted."""
    if not checked_at.is_set():
        bridge.message("the grasp starts when the page is open (--no-wait: immediately)")
    while not (checked_at.wait(0.1) or bridge.closed.is_set()):
        signals.check()


def _run(bridge: SessionBridge) -> None:
    """Run one grasp and show its errors. Raise them if there was no image yet."""
    before = bridge.runs
    try:
        # no time limit, because manual control may take any time
        scenario = replace(bridge.scenario, time_limit=math.inf)
        controller = bridge.take_over(load_controller(scenario.controller))
        result = run_grasp(scenario, [bridge], controller=controller)
        bridge.outcome = f"{result.outcome}" + (f": {result.reason}" if result.reason else "")
    except RestartRequested:
        bridge.outcome = "again"
    except Interrupted:
        raise
    except MjtactileError as error:
        if before == 0 and bridge.latest is None:
            raise
        bridge.outcome = str(error)


def _sync(
    handle: viewer_handle.ViewerHandle, mirror: StateSync, bridge: SessionBridge, errors: list[str]
) -> None:
    """Run Studio's simulation loop; new states, and some repeated ones, are sent.

    An error of the viewer is added to `errors`.
    """
    try:
        sent = 0.0
        with handle:
            while handle.is_running() and not bridge.closed.is_set():
                if mirror.follow() or time.monotonic() - sent > _EVERY:
                    handle.sync()
                    sent = time.monotonic()
                time.sleep(_PERIOD)
    except Exception as error:  # noqa: BLE001  # the viewer ended; the session ends, too
        errors.append(" ".join(f"{type(error).__name__}: {error}".split()))
    finally:
        bridge.closed.set()
