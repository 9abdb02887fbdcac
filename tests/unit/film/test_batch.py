"""Threads that share a batch out."""

import threading
from functools import partial

import pytest

from mjtactile.film.batch import at_once


def test_what_fails_in_a_thread_is_raised_and_the_thread_goes_on():
    def work(number, seen):
        seen[number] = threading.current_thread()
        if number == 1:
            raise ValueError("in another thread")

    first, second = {}, {}
    alive = []
    for seen in (first, second):
        with pytest.raises(ValueError, match="in another thread"):
            at_once(3, partial(work, seen=seen))
        alive.append({one for one in threading.enumerate() if one.name.startswith("film-")})
    assert set(first) == set(second) == {0, 1, 2}
    assert first[0] is second[0] is threading.current_thread()
    assert len(alive[0]) >= 2 and alive[0] == alive[1]  # they stayed, and no other came
    assert set(second.values()) <= alive[1] | {second[0]}
