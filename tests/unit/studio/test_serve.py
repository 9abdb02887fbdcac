"""Tests of the start of Studio's page."""

import socket
import threading

import pytest

from mjtactile.core.errors import DeviceError, InputError, Interrupted, MjtactileError
from mjtactile.studio import serve
from mjtactile.studio.session_bridge import SessionBridge
from tests.fake_run import fake_cycle


@pytest.mark.parametrize(("error", "ends"), [(Interrupted(), True), (DeviceError("a wire"), False)])
def test_ctrl_c_ends_the_viewer_and_a_failure_of_a_run_is_shown(monkeypatch, error, ends):
    bridge = SessionBridge()

    def fail(*_, **__):
        bridge.add(fake_cycle(0))
        raise error

    monkeypatch.setattr(serve, "run_grasp", fail)
    if ends:
        with pytest.raises(Interrupted):
            serve._run(bridge)
    else:
        serve._run(bridge)
        assert bridge.outcome == "a wire"


def test_a_window_without_a_display_is_one_line_with_a_remedy(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(
        MjtactileError, match=r"--native: no display is available .*: omit --native"
    ) as error:
        serve.launch_window(None, [])
    assert "\n" not in str(error.value)


def test_missing_features_of_mujocos_window_are_named(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":9")

    def missing_module(name):
        raise ImportError("no library of that name")

    monkeypatch.setattr(serve.importlib, "import_module", missing_module)
    with pytest.raises(
        MjtactileError, match=r"does not work here \(no library of that name\): omit --native"
    ):
        serve.launch_window(None, [])


def test_a_grasp_waits_for_its_page(monkeypatch):
    """A grasp states that it waits for its page; Studio's end or a signal ends the wait."""
    text = []
    bridge = SessionBridge(notify=text.append)
    frames = threading.Event()
    monkeypatch.setattr(serve, "checked_at", frames)
    threading.Timer(0.05, frames.set).start()
    serve._wait_for_page(bridge)
    assert frames.is_set() and "--no-wait" in text[0]
    serve._wait_for_page(bridge)
    assert len(text) == 1  # it is open
    frames.clear()
    threading.Timer(0.05, bridge.closed.set).start()
    serve._wait_for_page(bridge)
    assert not frames.is_set()


def test_a_used_port_is_refused_before_the_viewer_starts():
    """The port is checked in the main thread: exit code 2 and one line that names the option."""
    with socket.create_server(("127.0.0.1", 0)) as used:
        port = used.getsockname()[1]
        with pytest.raises(InputError, match=rf"--port: port {port} is not available") as error:
            serve.watch(SessionBridge(), port=port, browser=False)
    assert error.value.exit_code == 2
    serve.require_free_port(port)
    serve.require_free_port(0)


def test_a_viewer_that_fails_ends_the_session_with_an_error(monkeypatch):
    """Its error is raised with exit code 3, not printed with exit code 0."""

    class FailingViewer:
        def __enter__(self):
            raise RuntimeError("no free\nport")

        def __exit__(self, *_):
            pass

    monkeypatch.setattr(serve, "launch", lambda config, plugins: FailingViewer())
    with pytest.raises(MjtactileError, match="Studio ended: RuntimeError: no free port") as error:
        serve.watch(SessionBridge(), browser=False, wait=True)
    assert error.value.exit_code == 3
