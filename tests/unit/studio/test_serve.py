"""Tests of the start of Studio's page."""

import threading

import pytest

from mjtactile.core.errors import DeviceError, Interrupted, MjtactileError
from mjtactile.studio import serve
from mjtactile.studio.session_bridge import SessionBridge
from tests.fake_run import fake_cycle


@pytest.mark.parametrize(("error", "ends"), [(Interrupted(), True), (DeviceError("a wire"), False)])
def test_ctrl_c_ends_it_and_what_fails_in_a_run_is_shown(monkeypatch, error, ends):
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


def test_a_window_without_a_display_is_one_line_that_says_what_to_do(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(
        MjtactileError, match=r"--native: no display is available .*: omit --native"
    ) as error:
        serve.launch_window(None, [])
    assert "\n" not in str(error.value)


def test_what_mujocos_window_lacks_is_named(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":9")

    def lacking(name):
        raise ImportError("no library of that name")

    monkeypatch.setattr(serve.importlib, "import_module", lacking)
    with pytest.raises(
        MjtactileError, match=r"does not work here \(no library of that name\): omit --native"
    ):
        serve.launch_window(None, [])


def test_a_grasp_waits_for_its_page(monkeypatch):
    """A grasp states that it waits for its page; Studio's end or a signal ends the wait."""
    text = []
    bridge = SessionBridge(say=text.append)
    looked = threading.Event()
    monkeypatch.setattr(serve, "checked_at", looked)
    threading.Timer(0.05, looked.set).start()
    serve._wait_for_page(bridge)
    assert looked.is_set() and "--no-wait" in text[0]
    serve._wait_for_page(bridge)
    assert len(text) == 1  # it is open
    looked.clear()
    threading.Timer(0.05, bridge.closed.set).start()
    serve._wait_for_page(bridge)
    assert not looked.is_set()
