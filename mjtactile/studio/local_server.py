"""MuJoCo Studio in the browser for the local computer only.

Here MuJoCo's server is bound to loopback and answers only its own pages. Unmodified, it binds every
interface and has no option for it. It also lets any open web page of the user read the model and
send messages. There is no option against that either.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Sequence
from typing import Any
from urllib.parse import urlsplit

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
from websockets.http11 import Request, Response

LOOPBACK = "127.0.0.1"
# any port, because a tunnel has its own; another name may be a foreign name that points to this
# computer
_HOST = re.compile(r"(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
_SHOWS = "/state"
_OURS = ("same-origin", "none")
"""Accepted values of Sec-Fetch-Site: requests by the server's own page or directly by its user."""
_serve_unguarded = web_server.serve
checked_at = threading.Event()
"""Event that is set when a page has requested the state."""


def refusal(headers: Headers) -> str:
    """Return the reason to reject a request with these headers; "" to accept it.

    The request must use a name of this computer, because a site could let its own name point here.
    It must also come from a page of the same origin.
    """
    host = headers.get("Host", "")
    if not _HOST.fullmatch(host.lower()):
        return f"not available for {host!r}: the server accepts requests from its own computer only"
    origin = headers.get("Origin")
    if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
        return f"not available for pages of {origin!r}"
    opens_page = headers.get("Sec-Fetch-Mode") == "navigate"
    if not opens_page and headers.get("Sec-Fetch-Site", "none") not in _OURS:
        return "not available for other pages"
    return ""


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


class LoopbackViewer(web_viewer.WebViewer):
    """MuJoCo's web viewer, which binds every interface and has no option for it, on loopback."""

    _host = property(lambda self: LOOPBACK, lambda self, _: None)


def launch(
    config: viewer_protocol.ViewerConfig | None = None, *, plugins: Sequence[Any] = ()
) -> viewer_handle.ViewerHandle:
    """Serve Studio in a thread on loopback, like `mujoco.studio.launch_web.launch`; return
    immediately.

    Use the result as a context manager; call its `sync(model, data)` after each of your steps.
    """
    config = viewer_protocol.ViewerConfig(gfx="web") if config is None else config
    viewers, sims = plugin.split_plugins(plugins)

    def run(endpoint: endpoints.ViewerEndpoint) -> None:
        viewer_protocol.run_viewer_loop(LoopbackViewer(config, endpoint, plugins=viewers))

    return launch_thread.launch_thread(run, sim_plugins=sims)
