"""Tests of threads that divide a batch."""

import threading
from functools import partial

import pytest

from mjtactile.core.errors import InputError
from mjtactile.quasistatic import QuasistaticMembrane
from mjtactile.quasistatic.batch import run_in_threads


def test_an_error_in_a_thread_is_raised_and_the_thread_continues():
    def work(number, seen):
        seen[number] = threading.current_thread()
        if number == 1:
            raise ValueError("in another thread")

    first, second = {}, {}
    alive = []
    for seen in (first, second):
        with pytest.raises(ValueError, match="in another thread"):
            run_in_threads(3, partial(work, seen=seen))
        alive.append({item for item in threading.enumerate() if item.name.startswith("membrane-")})
    assert set(first) == set(second) == {0, 1, 2}
    assert first[0] is second[0] is threading.current_thread()
    assert (
        len(alive[0]) >= 2 and alive[0] == alive[1]
    )  # the same threads continue, and no other was started
    assert set(second.values()) <= alive[1] | {second[0]}


def test_an_invalid_batch_is_refused_in_one_line_that_names_it():
    membrane = QuasistaticMembrane("dense", (9, 7))
    ball = membrane.obstacle("sphere", (8e-3,), (0.0, 0.0, 0.03))
    one = membrane.solve(ball)
    for message, call in (
        ("obstacles: must be a list", lambda: membrane.solve_batch(None)),
        ("obstacles: must be a list", lambda: membrane.solve_batch([3])),
        ("obstacles: every environment", lambda: membrane.solve_batch([])),
        ("threads: '2' is not a whole", lambda: membrane.solve_batch([ball], threads="2")),
        (
            "batch: MembraneSolution is not a MembraneSolutionBatch",
            lambda: membrane.solve_batch([ball], one),
        ),
        ("into: int is not a MembraneSolutionBatch", lambda: membrane.solve_batch([ball], into=3)),
        ("state: str is not a MembraneSolution", lambda: membrane.solve(ball, "x")),
        (r"gauge_pressure: \[1000\] is not", lambda: QuasistaticMembrane("dense", (9, 7), [1000])),
    ):
        with pytest.raises(InputError, match=message) as caught:
            call()
        assert "\n" not in str(caught.value)
    assert membrane.solve_batch([ball], threads=2).converged.all()
