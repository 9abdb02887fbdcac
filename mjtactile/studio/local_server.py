"""MuJoCo Studio in the browser for the local computer only.

Here MuJoCo's server is bound to loopback and answers only its own pages. Unmodified, it binds every
interface and has no option for it. Any open web page of the user can then also read the model and
send messages. There is no option against that either.
"""

from __future__ import annotations

import logging
import threading
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
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from mjtactile.core.loopback import LOOPBACK, refusal

_SHOWS = "/state"
_serve_unguarded = web_server.serve
checked_at = threading.Event()
"""Event that is set when a page has requested the state."""


def serve(*args: Any, process_request: Any, process_response: Any, **options: Any) -> Any:
    """Call `websockets.asyncio.server.serve` with MuJoCo's handlers protected by `refusal`.

    Their responses are readable by the server's own page only.
    """

    def ask(connection: ServerConnection, request: Request) -> Response | None:
        why = refusal(request.headers)
        if why:
            return Response(403, "Forbidden", Headers(), f"{why}\n".encode())
        if request.path.partition("?")[0] == _SHOWS:
            checked_at.set()
        return process_request(connection, request)

    def answer(
        connection: ServerConnection, request: Request, response: Response
    ) -> Response | None:
        process_response(connection, request, response)
        del response.headers["Access-Control-Allow-Origin"]
        del response.headers["Cross-Origin-Resource-Policy"]
        response.headers["Cross-Origin-Resource-Policy"] = "same-origin"
        return None

    return _serve_unguarded(*args, process_request=ask, process_response=answer, **options)


web_server.serve = serve


def is_fault(record: logging.LogRecord) -> bool:
    """Return False if the record reports only that a page closed while data was sent to it.

    MuJoCo's server leaves this exception in a task, which asyncio logs with a traceback.
    """
    return not (record.exc_info and isinstance(record.exc_info[1], ConnectionClosed))


logging.getLogger("asyncio").addFilter(is_fault)


class LoopbackViewer(web_viewer.WebViewer):
    """MuJoCo's web viewer, which binds every interface and has no option for it, on loopback."""

    _host = property(lambda self: LOOPBACK, lambda self, _: None)


def launch(
    config: viewer_protocol.ViewerConfig | None = None, *, plugins: Sequence[Any] = ()
) -> viewer_handle.ViewerHandle:
    """Serve Studio in a thread on loopback, like `mujoco.studio.launch_web.launch`; return
    immediately.

    Use the result as a context manager. Call its `sync(model, data)` after each of your steps.
    """
    config = viewer_protocol.ViewerConfig(gfx="web") if config is None else config
    viewers, sims = plugin.split_plugins(plugins)

    def run(endpoint: endpoints.ViewerEndpoint) -> None:
        viewer_protocol.run_viewer_loop(LoopbackViewer(config, endpoint, plugins=viewers))

    return launch_thread.launch_thread(run, sim_plugins=sims)
