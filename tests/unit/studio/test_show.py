"""What a session shows and what is asked of it, without a viewer."""

import threading
import time

import numpy as np
import pytest

from mjtactile.run.grasp import GraspOptions, run_grasp
from mjtactile.studio.plugins import finger_lines
from mjtactile.studio.show import Restart, Show, Voice
from tests.fake_run import fake_cycle


class FakeWorld:
    """A rig's stand-in: only whether it is simulated is asked."""

    scene = None


def until(condition, limit=60.0):
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)


def shown(show, count=1):
    for i in range(count):
        show.add(fake_cycle(i), force_normal_true=[0.1, 0.2])


def test_a_cycle_is_shown_with_what_was_true():
    show = Show()
    shown(show, 3)
    assert show.latest.number == 2 and show.rows[-1].true == (0.1, 0.2)
    lines = finger_lines(show.latest, 1)
    assert lines[0].startswith(f"normal {show.latest.cycle.touch[1].force_normal:+.3f} N")
    assert "true   +0.200 N" in lines


def test_the_plots_show_the_last_seconds_only():
    show = Show()
    for i in range(0, 3000, 10):  # 100 s
        show.add(fake_cycle(i, 3001))
    assert show.rows[-1].time - show.rows[0].time == pytest.approx(20, abs=0.4)  # a cycle of 0.33 s


def test_a_pause_holds_the_session_until_it_goes_on():
    show = Show()
    show.paused = True
    thread = threading.Thread(target=shown, args=(show, 3))
    thread.start()
    until(lambda: show.latest is not None)
    time.sleep(0.1)
    assert show.latest.number == 0
    show.step()
    until(lambda: show.latest.number == 1)
    time.sleep(0.1)
    assert show.latest.number == 1
    show.paused = False
    thread.join(10)
    assert show.latest.number == 2


def test_what_is_asked_for_is_done_by_the_sessions_thread_and_what_raises_is_said():
    show, done = Show(), []
    show.session = object()
    show.session = type("S", (), {"rig": FakeWorld()})()
    show.ask(lambda session: done.append(threading.current_thread().name))
    show.ask(lambda session: 1 / 0)
    show.ask(lambda session: done.append("after"))
    thread = threading.Thread(target=shown, args=(show,), name="session")
    thread.start()
    thread.join()
    assert done == ["session", "after"] and show.message == "ZeroDivisionError: division by zero"


def test_another_run_and_a_closed_viewer_end_this_one():
    for name in ("restart", "closed"):
        show = Show()
        getattr(show, name).set()
        with pytest.raises(Restart):
            show.add(fake_cycle(0))


def test_a_grasp_shows_its_scene_and_its_valves_obey():
    """Real physics: the scene's state is the world's, and a valve that is opened from outside changes what is felt."""
    show = Show()
    show.fastest = np.inf
    states = []

    def look(session):
        states.append((show.latest.view.state.copy(), [valve.state().is_open for valve in session.rig.valves]))
        if len(states) == 2:
            for valve in session.rig.valves:
                valve.open(500.0)
        if len(states) < 6:
            show.ask(look)
        else:
            show.restart.set()

    show.ask(look)
    with pytest.raises(Restart):
        run_grasp(GraspOptions(workers=0), recorder=show, progress=Voice(show), on_open=show.open)
    assert [opened[0] for _, opened in states] == [False, False, True, True, True, True]
    assert len({state.shape for state, _ in states}) == 1 and np.ptp([state[0] for state, _ in states]) > 0.1  # its time
