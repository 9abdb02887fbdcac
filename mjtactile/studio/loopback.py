"""MuJoCo Studio in the browser, for this computer alone."""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from typing import Any

from mujoco.studio import (
    endpoints,
    launch_thread,
    plugin,
    viewer_handle,
    viewer_protocol,
    web_viewer,
)
from mujoco.studio.web import web_server

LOOPBACK = "127.0.0.1"
# any port: a tunnel has its own
_PAGES = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
# MuJoCo's server lets any page of the web that the user has open talk to it, and has no option for
# it either.
web_server.serve = functools.partial(web_server.serve, origins=[None, _PAGES])


class LoopbackViewer(web_viewer.WebViewer):
    """MuJoCo's web viewer, which binds every interface and has no option for it, on loopback."""

    _host = property(lambda self: LOOPBACK, lambda self, _: None)


def launch(
    config: viewer_protocol.ViewerConfig | None = None, *, plugins: Sequence[Any] = ()
) -> viewer_handle.ViewerHandle:
    """`mujoco.studio.launch_web.launch`, on loopback: serves Studio in a thread and returns at
    once.

    Use what it returns as a context manager; call its `sync(model, data)` after each of your steps.
    """
    config = viewer_protocol.ViewerConfig(gfx="web") if config is None else config
    viewers, sims = plugin.split_plugins(plugins)

    def serve(endpoint: endpoints.ViewerEndpoint) -> None:
        viewer_protocol.run_viewer_loop(LoopbackViewer(config, endpoint, plugins=viewers))

    return launch_thread.launch_thread(serve, sim_plugins=sims)
