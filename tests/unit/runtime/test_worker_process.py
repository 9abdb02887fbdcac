"""Tests of the data exchange with a process next to a run."""

import mmap
import socket

import numpy as np
import pytest

from mjtactile.runtime.worker_process import Channel

ROOM = 1 << 12
RNG = np.random.default_rng(0)


@pytest.fixture
def ends():
    """Provide both ends of a channel; the first lends the other a page of memory."""
    own_end, other_end = socket.socketpair()
    with own_end, other_end, mmap.mmap(-1, ROOM) as memory:
        yield Channel(own_end, lent=memory), Channel(other_end, given=memory)


@pytest.mark.parametrize("count", [0, 1, 3, ROOM // 8, ROOM // 8 + 1])
def test_arrays_are_transferred_unchanged_at_any_size(ends, count):
    one, other = ends
    numbers = RNG.normal(size=count)
    odd = RNG.integers(0, 256, (1, 1, 1), np.uint8)  # the next array starts at an aligned offset
    one.send("seen", [odd, numbers], {"time": 0.5})
    word, (first, second), reported = other.receive(1.0)
    assert (word, reported) == ("seen", {"time": 0.5})
    np.testing.assert_array_equal(first, odd)
    np.testing.assert_array_equal(second, numbers)
    assert not second.flags.writeable or not count


def test_a_received_array_is_unchanged_by_later_messages(ends):
    one, other = ends
    one.send(np.zeros(9))
    (kept,) = other.receive(1.0)
    one.send(np.ones(9))
    other.receive(1.0)
    np.testing.assert_array_equal(kept, np.zeros(9))


def test_an_answer_needs_no_memory(ends):
    one, other = ends
    other.send(np.arange(20000))
    np.testing.assert_array_equal(one.receive(1.0)[0], np.arange(20000))


def test_a_closed_process_refuses_requests_like_a_lost_process():
    own_end, other_end = socket.socketpair()
    with other_end:
        one = Channel(own_end, lent=mmap.mmap(-1, ROOM))
        one.close()
        with pytest.raises(OSError):
            one.send(np.zeros(9))
