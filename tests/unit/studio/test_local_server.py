"""Tests of Studio's server: its own pages are served, requests of other sites are refused."""

import asyncio
import contextlib
import gc
import http.client
import socket

import pytest
from mujoco.studio.web import web_server
from websockets.exceptions import ConnectionClosedOK

from mjtactile.studio import local_server
from tests.emulated import wait_for

MODEL = b"a model that is nobody else's business"


@pytest.fixture(scope="module")
def port(tmp_path_factory):
    """Provide MuJoCo's server, started as by Studio, without a viewer."""
    public = web_server.bind_public_socket(local_server.LOOPBACK, _free_port())
    pages = tmp_path_factory.mktemp("pages")
    (pages / "index.html").write_text("the page")
    server = web_server.WebServer(
        public, web_server.bind_loopback_socket(), str(pages), mjb_data=MODEL
    )
    server.start()
    number = public.getsockname()[1]
    assert wait_for(lambda: _listens(number))
    yield number
    server.stop()


def _free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _listens(port):
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def get(port, path, **headers):
    """Return (status, headers, body) of a GET; `{port}` in a header is replaced by the server's."""
    sent = {name.replace("_", "-"): value.format(port=port) for name, value in headers.items()}
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port, timeout=10)) as client:
        client.request("GET", path, headers=sent)
        answer = client.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()


@pytest.mark.parametrize("path", ["/model", "/model?crc32=0", "/", "/ui", "/state"])
@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "https://evil.example"},
        {"Origin": "null"},  # a sandboxed frame, a file
        {"Origin": "http://localhost:1"},  # another server of this computer
        {"Host": "evil.example:{port}"},  # whose name points at this computer
        {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "no-cors"},  # <script src=...>
    ],
    ids=["another site", "no origin", "another port", "another name", "a script"],
)
def test_requests_of_other_origins_are_refused(port, path, headers):
    status, reply_headers, body = get(port, path, **headers)
    assert (
        status == 403 and MODEL not in body and "Access-Control-Allow-Origin" not in reply_headers
    )


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Host": "localhost:{port}", "Origin": "http://localhost:{port}"},
        {"Host": "localhost:9999", "Origin": "http://localhost:9999"},  # through a tunnel
        {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "navigate"},  # the user opens a link
    ],
    ids=["no browser", "the page", "a tunnel", "a link"],
)
def test_the_page_gets_its_model_and_no_other_page_may_read_it(port, headers):
    status, reply_headers, body = get(port, "/model", **headers)
    assert (status, body) == (200, MODEL)
    assert "Access-Control-Allow-Origin" not in reply_headers
    assert reply_headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert reply_headers["Cross-Origin-Embedder-Policy"] == "require-corp"  # its threads need it


def test_an_own_page_is_accepted_and_another_is_refused(port):
    local_server.checked_at.clear()
    get(port, "/")
    get(port, "/state", Origin="https://evil.example")
    assert not local_server.checked_at.is_set()
    get(port, "/state?sid=1")
    assert local_server.checked_at.is_set()


@pytest.mark.parametrize(("error", "is_logged"), [(ConnectionClosedOK, False), (OSError, True)])
def test_a_page_closed_during_transfer_causes_no_error(caplog, error, is_logged):
    """An exception that a task of the server leaves is logged by asyncio, with its traceback."""

    async def send():
        raise error(None, None)

    async def leave():
        task = asyncio.ensure_future(send())
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        del task
        gc.collect()

    with caplog.at_level("ERROR", "asyncio"):
        asyncio.run(leave())
    assert bool(caplog.records) == is_logged
