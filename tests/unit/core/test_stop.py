"""Tests of terminating signals, sent to this process: raised without a connected rig, stored with a
connected rig."""

import signal
import threading

import pytest

from mjtactile.core import signals
from mjtactile.core.errors import Interrupted
from mjtactile.core.signals import ENDING, deferred, listening


@pytest.fixture(autouse=True)
def _handlers_are_as_before():
    before = [signal.getsignal(number) for number in ENDING]
    yield
    assert [signal.getsignal(number) for number in ENDING] == before


@pytest.mark.parametrize("number", ENDING)
def test_without_a_handler_the_first_signal_raises_and_its_echo_does_not(number):
    with listening() as stop:
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
        signal.raise_signal(number)  # shortly after, while the first signal is handled
        assert stop.asked and not stop.at_once


@pytest.mark.parametrize("number", ENDING)
def test_with_a_handler_the_signal_is_stored_and_raised_at_its_end(number):
    done = []
    with pytest.raises(Interrupted), deferred() as stop:
        for _ in range(6):
            signal.raise_signal(number)
        with deferred():  # a driver that closes within it
            done.append("inner")
        assert stop.asked and not stop.at_once
        done.append("outer")
    assert done == ["inner", "outer"]


def test_a_second_signal_stops_at_once(monkeypatch):
    with pytest.raises(Interrupted), deferred() as stop:
        signal.raise_signal(signal.SIGINT)
        monkeypatch.setattr(signals, "SECOND_TIME", 0.0)
        signal.raise_signal(signal.SIGTERM)
        assert stop.at_once


def test_repeated_sigxcpu_does_not_count_as_a_second_signal(monkeypatch):
    monkeypatch.setattr(signals, "SECOND_TIME", 0.0)
    with pytest.raises(Interrupted), deferred() as stop:
        for _ in range(3):
            signal.raise_signal(signal.SIGXCPU)
        signal.raise_signal(signal.SIGINT)
        assert stop.asked and not stop.at_once
        signal.raise_signal(signal.SIGINT)
        assert stop.at_once


def test_every_terminating_signal_is_handled():
    """All signals that end the process are handled, except those in the list.

    These cannot be caught, or a program fault raises them, or they do not end the process.
    """
    names = "KILL STOP ILL TRAP BUS FPE SEGV SYS PIPE XFSZ CHLD CONT TSTP TTIN TTOU URG WINCH"
    others = {getattr(signal, f"SIG{name}") for name in names.split()}
    assert signal.valid_signals() - set(ENDING) == others


def test_signals_with_a_user_handler_are_unchanged():
    received = []
    before = signal.signal(signal.SIGUSR1, lambda *_: received.append(1))
    try:
        with deferred() as stop:
            signal.raise_signal(signal.SIGUSR1)
            assert received and not stop.asked
    finally:
        signal.signal(signal.SIGUSR1, before)


def test_an_error_during_the_stop_is_raised():
    with pytest.raises(ZeroDivisionError), deferred():
        signal.raise_signal(signal.SIGINT)
        _ = 1 / 0


def test_a_stored_signal_is_raised_at_a_safe_point():
    signals.check()
    with pytest.raises(Interrupted), deferred():
        signals.check()
        signal.raise_signal(signal.SIGINT)
        signals.check()
        pytest.fail("it went on")


def test_an_ignored_hang_up_signal_stays_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with deferred() as stop:
            signal.raise_signal(signal.SIGHUP)
            assert not stop.asked
    finally:
        signal.signal(signal.SIGHUP, before)


def test_signals_of_the_main_thread_are_visible_in_other_threads():
    observed = []

    def work():
        with deferred() as stop:
            signal.raise_signal(signal.SIGINT)
            started.set()
            over.wait(10)
            observed.append(stop.asked)

    started = threading.Event()
    over = threading.Event()
    with pytest.raises(Interrupted), deferred() as stop:
        thread = threading.Thread(target=work)
        thread.start()
        started.wait(10)
        observed.append(stop.asked)
        over.set()
        thread.join()
    assert observed == [True, True]
