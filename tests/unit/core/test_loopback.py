"""Servers of this computer answer their own pages and viewers, and no other site's page."""

import socket
import threading

import pytest
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import connect
from websockets.sync.server import serve

from mjtactile.core.loopback import LoopbackGate, hidden_address, refusal

VIEWER = "https://viewer.example"


@pytest.fixture(scope="module")
def gate():
    """Provide a server that accepts any page, and repeats what it receives, behind a gate."""

    def echo(connection):
        for message in connection:
            connection.send(message)

    host = hidden_address()
    with serve(echo, host, 0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        gate = LoopbackGate(0, (host, server.socket.getsockname()[1]), [VIEWER])
        yield gate
        gate.close()
        server.shutdown()


def headers(**more):
    return {name.replace("_", "-"): value for name, value in more.items()}


ACCEPTED = {
    "a program": {},
    "the viewer": {"Origin": VIEWER, "Sec_Fetch_Site": "cross-site"},
    "the viewer, written otherwise": {"Origin": VIEWER.upper()},
    "a desktop application": {"Origin": "file://"},
    "another desktop application": {"Origin": "viewer://app"},
    "through a tunnel": {"Host": "localhost:9999"},
}
REFUSED = {
    "another site": {"Origin": "https://evil.example"},
    "a site that contains the name": {"Origin": VIEWER + ".evil.example"},
    "the viewer without encryption": {"Origin": "http://viewer.example"},
    "a sandboxed frame": {"Origin": "null"},
    "another server of this computer": {"Origin": "http://localhost:1"},
    "another name": {"Host": "evil.example:8765"},
    "another name that starts as ours": {"Host": "localhost.evil.example"},
    "another name, with the viewer": {"Host": "evil.example", "Origin": VIEWER},
    "an address of the network": {"Host": "192.168.0.7:8765"},
    "a page without an origin": {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "websocket"},
}


def reply_to(gate, message, **more):
    """Return the answer to a message over the gate."""
    with connect(f"ws://127.0.0.1:{gate.port}", additional_headers=headers(**more)) as client:
        client.send(message)
        return client.recv(timeout=10)


@pytest.mark.parametrize("kind", [name for name in ACCEPTED if "tunnel" not in name])
def test_an_accepted_connection_is_passed_on_unchanged(gate, kind):
    assert reply_to(gate, "x" * 300_000, **ACCEPTED[kind]) == "x" * 300_000


@pytest.mark.parametrize("kind", [name for name in REFUSED if "Host" not in REFUSED[name]])
def test_a_connection_of_another_page_is_refused(gate, kind):
    with pytest.raises(InvalidHandshake, match="403"):
        reply_to(gate, "x", **REFUSED[kind])


def raw(gate, head):
    with socket.create_connection(("127.0.0.1", gate.port), timeout=10) as end:
        end.sendall(head)
        return end.recv(100)


@pytest.mark.parametrize(
    "lines",
    [
        ["Host: evil.example", "Upgrade: websocket"],
        ["Host: localhost", "Host: evil.example", "Upgrade: websocket"],
        ["Host: localhost", f"Origin: {VIEWER}", "Origin: https://e.example", "Upgrade: websocket"],
        ["Host: localhost"],
        ["Upgrade: websocket"],
    ],
    ids=["another name", "two names", "two origins", "a page", "no name"],
)
def test_an_invalid_request_is_refused(gate, lines):
    head = "\r\n".join(["GET / HTTP/1.1", *lines, "", ""]).encode()
    assert raw(gate, head).startswith(b"HTTP/1.1 403")


def test_an_endless_request_is_cut_off(gate):
    """The head of a request is limited: the gate closes the connection, and accepts the next
    request."""
    with socket.create_connection(("127.0.0.1", gate.port), timeout=10) as end:
        end.sendall(b"GET / HTTP/1.1\r\n")
        try:
            for _ in range(100):
                end.sendall(b"x" * 1000)
            assert end.recv(1) == b""
        except ConnectionError:
            pass
    assert reply_to(gate, "x") == "x"


@pytest.mark.parametrize("kind", ACCEPTED)
def test_viewers_are_accepted(kind):
    assert refusal({"Host": "localhost:8765", **headers(**ACCEPTED[kind])}, [VIEWER]) == ""


@pytest.mark.parametrize("kind", REFUSED)
@pytest.mark.parametrize("viewers", [None, [VIEWER]], ids=["pages", "viewers"])
def test_other_pages_are_refused_by_every_server(kind, viewers):
    assert refusal({"Host": "localhost:8765", **headers(**REFUSED[kind])}, viewers)


def test_a_closed_gate_frees_its_port_and_ends_connections():
    with serve(lambda one: one.recv(), "127.0.0.1", 0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        gate = LoopbackGate(0, server.socket.getsockname(), [])
        with connect(f"ws://127.0.0.1:{gate.port}") as client:
            gate.close()
            with pytest.raises(ConnectionClosed):
                client.recv(timeout=10)
        LoopbackGate(gate.port, ("127.0.0.1", 1), []).close()
        server.shutdown()
