"""Camera images as MJPEG multipart streams on loopback HTTP: `http://127.0.0.1:PORT/left`."""

from __future__ import annotations

import contextlib
import socket
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
from numpy.typing import NDArray

_BOUNDARY = "frame"
_JPEG = [cv2.IMWRITE_JPEG_QUALITY, 98]  # the codec's loss stays below the camera's own noise


class _Channel:
    """Newest image of one camera, and a condition that notifies waiting clients."""

    def __init__(self) -> None:
        self.bell = threading.Condition()
        self.jpeg = b""
        self.number = 0


class StreamServer:
    """Server with one stream for each name. `publish` sends an image; `close` ends all streams."""

    def __init__(self, names: tuple[str, ...]):
        self._channels = {name: _Channel() for name in names}
        self._closing = False
        self._sockets: set[socket.socket] = set()
        server = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.0"
            wbufsize = 0

            def do_GET(self) -> None:
                server._serve(self)

            def log_message(self, format: str, *args: object) -> None:  # the base class's name
                pass

        class Server(ThreadingHTTPServer):
            daemon_threads = True
            block_on_close = True

        self._server = Server(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.05,), name="streams", daemon=True
        )
        self._thread.start()

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._channels)

    def url(self, name: str) -> str:
        return f"http://127.0.0.1:{self._server.server_port}/{name}"

    def publish(self, name: str, pixels: NDArray) -> None:
        """Send an image (H, W) uint8 to all clients of this camera."""
        jpeg = cv2.imencode(".jpg", pixels, _JPEG)[1].tobytes()
        channel = self._channels[name]
        with channel.bell:
            channel.jpeg = jpeg
            channel.number = channel.number + 1
            channel.bell.notify_all()

    def close(self) -> None:
        self._closing = True
        for channel in self._channels.values():
            with channel.bell:
                channel.bell.notify_all()
        for watcher in list(self._sockets):
            with contextlib.suppress(OSError):
                watcher.shutdown(socket.SHUT_RDWR)
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def _serve(self, handler: BaseHTTPRequestHandler) -> None:
        channel = self._channels.get(handler.path.strip("/"))
        if channel is None:
            handler.send_error(404)
            return
        handler.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._sockets.add(handler.connection)
        with contextlib.suppress(OSError):
            handler.send_response(200)
            handler.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
            handler.end_headers()
            self._send_all(handler, channel)
        self._sockets.discard(handler.connection)

    def _send_all(self, handler: BaseHTTPRequestHandler, channel: _Channel) -> None:
        number = channel.number - 1 if channel.number else 0
        while True:
            with channel.bell:
                while not self._closing and channel.number <= number:
                    channel.bell.wait()
                jpeg = channel.jpeg
                number = channel.number
            if self._closing:
                return
            head = (
                f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            ).encode()
            handler.wfile.write(head + jpeg + b"\r\n")
