"""Studio in the browser, on loopback only, and the runs that it shows."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from typing import Any

from mujoco.studio import app, endpoints, launch_thread, plugin, viewer_handle, viewer_protocol, web_viewer

from mjtactile.core.errors import MjtactileError
from mjtactile.run.grasp import GraspOptions, run_grasp
from mjtactile.studio.plugins import Mirror, Panel
from mjtactile.studio.show import Restart, Show, Voice

LOOPBACK = "127.0.0.1"
_PERIOD = 0.005  # s between two looks at the session


class LoopbackViewer(web_viewer.WebViewer):
    """MuJoCo's web viewer, which binds every interface and has no option for it, on loopback."""

    _host = property(lambda self: LOOPBACK, lambda self, _: None)


def launch(config: viewer_protocol.ViewerConfig, plugins: list[Any]) -> viewer_handle.ViewerHandle:
    """`launch_web.launch` on loopback."""
    viewers, sims = plugin.split_plugins(plugins)

    def serve(endpoint: endpoints.ViewerEndpoint) -> None:
        viewer_protocol.run_viewer_loop(LoopbackViewer(config, endpoint, plugins=viewers))

    return launch_thread.launch_thread(serve, sim_plugins=sims)


def watch(options: GraspOptions, show: Show, *, port: int = 0, browser: bool = True, runs: int = 0) -> None:
    """Run grasp after grasp, each watched, until the viewer is closed or Ctrl-C; `runs`: at most so many.

    Raises what `run_grasp` raises of the first run; later ones are said in the panel, which goes on.
    """
    config = viewer_protocol.ViewerConfig(title=f"mjtactile: {options.object}", http_port=port, open_browser=browser, gfx="web")
    mirror = Mirror(show)
    handle = launch(config, [app.App(), Panel(show), mirror])
    studio = threading.Thread(target=_sync, args=(handle, mirror, show), name="studio", daemon=True)
    studio.start()
    try:
        while not show.closed.is_set():
            show.restart.clear()
            _run(options, show)
            if runs and show.runs >= runs:
                return
            while not (show.restart.wait(0.1) or show.closed.is_set()):
                pass
            options = replace(options, seed=options.seed + 1)
    finally:
        show.closed.set()
        studio.join(5.0)


def _run(options: GraspOptions, show: Show) -> None:
    """One grasp; what fails is shown, and raised where nothing has been shown yet."""
    try:
        result = run_grasp(options, recorder=show, progress=Voice(show), on_open=show.open)
        show.outcome = f"{result.outcome}" + (f": {result.reason}" if result.reason else "")
    except Restart:
        show.outcome = "again"
    except MjtactileError as error:
        if show.latest is None:
            raise
        show.outcome = str(error)


def _sync(handle: viewer_handle.ViewerHandle, mirror: Mirror, show: Show) -> None:
    """Studio's simulation loop."""
    try:
        with handle:
            while handle.is_running() and not show.closed.is_set():
                mirror.follow()
                handle.sync()
                time.sleep(_PERIOD)
    except Exception as error:  # noqa: BLE001  # the viewer ended; the session is told
        show.message_(f"{type(error).__name__}: {error}")
    finally:
        show.closed.set()


