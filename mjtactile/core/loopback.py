"""Access to servers on this computer: one check of Host and Origin, and a gate for other servers.

Any page that a user opens may send requests to ports of this computer, and any site may point its
own name to this computer. A server must therefore check the source of each request.
"""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import io
import random
import re
import socket
import sys
import threading
from collections.abc import Collection, Mapping
from email.message import Message
from urllib.parse import urlsplit

LOOPBACK = "127.0.0.1"
# any port, because a tunnel has its own; another name may be a foreign name that points to this
# computer
_HOST = re.compile(r"(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
_OURS = ("same-origin", "none")
"""Accepted values of Sec-Fetch-Site: requests by the server's own page or directly by its user."""
_PAGES = ("http", "https", "null", "")
"""Schemes of origins that a page in a browser can have."""
_HEAD_MAX = 1 << 14  # maximum size of a request's head, bytes
_HEAD_TIME = 5.0  # time limit for a request's head, s
_BLOCK = 1 << 16  # bytes


def refusal(headers: Mapping[str, str] | Message, viewers: Collection[str] | None = None) -> str:
    """Return the reason to reject a request with these headers; "" to accept it.

    The request must use a name of this computer, because a site could point its own name to this
    computer. It must also come from a page of the same origin.

    Args:
        headers: Headers of the request; `get` must ignore case.
        viewers: Origins of further accepted pages; desktop applications are then accepted, too.
            None: the server's own pages only.
    """
    host = headers.get("Host") or ""
    if not _HOST.fullmatch(host.lower()):
        return f"not available for {host!r}: the server accepts requests from its own computer only"
    origin = headers.get("Origin")
    if viewers is not None and origin is not None and _is_viewer(origin, viewers):
        return ""
    if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
        return f"not available for pages of {origin!r}"
    opens_page = headers.get("Sec-Fetch-Mode") == "navigate"
    if not opens_page and headers.get("Sec-Fetch-Site", "none") not in _OURS:
        return "not available for other pages"
    return ""


def _is_viewer(origin: str, viewers: Collection[str]) -> bool:
    return origin.lower() in viewers or urlsplit(origin).scheme not in _PAGES


def hidden_address() -> str:
    """Return a loopback address that a page cannot guess, for a server behind a gate.

    Linux has 2^24 of them; elsewhere it is the usual one.
    """
    if sys.platform != "linux":
        return LOOPBACK
    random_byte = random.SystemRandom().randint
    return f"127.{random_byte(1, 254)}.{random_byte(0, 255)}.{random_byte(1, 254)}"


class LoopbackGate:
    """Port on loopback that passes accepted WebSocket connections on to another server.

    It serves libraries whose servers accept any page. Connections are checked by `refusal`, and
    refused ones get status 403. The caller must close it.

    Args:
        port: Port of the gate; 0: any free one.
        target: Address and port of the server behind it.
        viewers: Origins of accepted pages, see `refusal`.

    Raises:
        OSError: The port is in use.
    """

    def __init__(self, port: int, target: tuple[str, int], viewers: Collection[str]):
        self._target = target
        self._viewers = viewers
        self._socket = socket.create_server((LOOPBACK, port))
        self.port: int = self._socket.getsockname()[1]
        self._loop = asyncio.new_event_loop()
        self._end = asyncio.Event()
        self._thread = threading.Thread(target=self._work, name="gate", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End all connections and free the port."""
        with contextlib.suppress(RuntimeError):  # already closed
            self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join(_HEAD_TIME)

    def _work(self) -> None:
        with contextlib.closing(self._loop):
            self._loop.run_until_complete(self._serve())

    async def _serve(self) -> None:
        server = await asyncio.start_server(self._pass_on, sock=self._socket, limit=_HEAD_MAX)
        await self._end.wait()
        server.close()
        connections = asyncio.all_tasks() - {asyncio.current_task()}
        for one in connections:
            one.cancel()
        await asyncio.gather(*connections, return_exceptions=True)

    async def _pass_on(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Handle one connection."""
        with contextlib.closing(writer), contextlib.suppress(OSError):
            try:
                head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _HEAD_TIME)
            except (TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
                return
            if why := self._refusal(head):
                body = f"{why}\n".encode()
                status = f"HTTP/1.1 403 Forbidden\r\nContent-Length: {len(body)}\r\n"
                writer.write(f"{status}Connection: close\r\n\r\n".encode() + body)
                await writer.drain()
                return
            answers, requests = await asyncio.open_connection(*self._target)
            with contextlib.closing(requests):
                requests.write(head)
                both = [_copy(reader, requests), _copy(answers, writer)]
                tasks = [asyncio.ensure_future(item) for item in both]
                await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                for task in tasks:
                    task.cancel()

    def _refusal(self, head: bytes) -> str:
        """Return the reason to reject a request with this head; "" to accept it."""
        try:
            headers = http.client.parse_headers(io.BytesIO(head.partition(b"\r\n")[2]))
        except http.client.HTTPException:
            return "not a valid request"
        twice = [name for name in ("Host", "Origin") if len(headers.get_all(name) or ()) > 1]
        if twice or (headers.get("Upgrade") or "").lower() != "websocket":
            return "not a WebSocket connection"
        return refusal(headers, self._viewers)


async def _copy(source: asyncio.StreamReader, target: asyncio.StreamWriter) -> None:
    """Copy bytes until the source or the target is closed."""
    with contextlib.suppress(OSError):
        while data := await source.read(_BLOCK):
            target.write(data)
            await target.drain()
