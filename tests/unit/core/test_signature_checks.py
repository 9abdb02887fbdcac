"""Tests of argument checks by several threads."""

import threading

from mjtactile.core import signature_checks
from mjtactile.core.signature_checks import validated


def test_two_threads_can_make_the_first_call(monkeypatch):
    """While one thread prepares the checks of a function, another thread may call it.

    The first thread waits after it has prepared the first argument. Checks that are stored one by
    one lack the second argument then.
    """
    halfway, resume = threading.Event(), threading.Event()
    prepare = signature_checks._kind

    def wait_at_second(annotation):
        if annotation is float and threading.current_thread() is first:
            halfway.set()
            assert resume.wait(10)
        return prepare(annotation)

    @validated()
    def add(count: int, amount: float) -> float:
        return count + amount

    monkeypatch.setattr(signature_checks, "_kind", wait_at_second)
    sums = []
    first = threading.Thread(target=lambda: sums.append(add(1, 2.0)))
    first.start()
    assert halfway.wait(10)
    try:
        assert add(3, amount=4.0) == 7.0
        assert add(3, 4.0) == 7.0
    finally:
        resume.set()
        first.join(10)
    assert sums == [3.0]
