"""Tests of the state of a session and the requests to it, without a viewer."""

import math
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from mjtactile.core.errors import DeviceError, Interrupted
from mjtactile.core.scenario import Scenario
from mjtactile.recording.observer import Observer
from mjtactile.report.overlay import find_ellipses, followed
from mjtactile.runtime.controller import load_controller
from mjtactile.runtime.grasp import run_grasp
from mjtactile.studio.manual_control import ManualGoal
from mjtactile.studio.session_bridge import RED_BUTTON, RestartRequested, SessionBridge
from mjtactile.studio.snapshot import finger_lines
from tests.fake_run import fake_cycle


def fake_session(host_timeout=math.inf):
    """A session's stand-in on a rig without a scene; keeps why it was to be made safe."""
    fingers = [SimpleNamespace(name=name, design=None) for name in ("left", "right")]
    rig = SimpleNamespace(scene=None, host_timeout=host_timeout, fingers=fingers)
    session = SimpleNamespace(rig=rig, perceptions=[None, None], reasons=[], flags={})
    session.make_safe = session.reasons.append
    return session


def until(condition, limit=300.0):
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)


def shown(show, count=1):
    for i in range(count):
        show.on_images()
        show.add(fake_cycle(i), force_normal_true=[0.1, 0.2])


def test_a_cycle_is_shown_with_what_was_true():
    show = SessionBridge()
    shown(show, 3)
    moment = show.moment()
    assert moment.number == 2 and show.history.rows[-1].true == (0.1, 0.2)
    lines = finger_lines(moment.fingers[1])
    assert lines[0].startswith(f"normal {moment.fingers[1].touch.force_normal:+.3f} N")
    assert "true   +0.200 N" in lines


def test_a_doubt_is_said_once_and_stays_beside_the_numbers():
    said = []
    show = SessionBridge(say=said.append)
    session = fake_session()
    session.flags = {"sharp_edge": "an edge presses"}
    show.begin(session)
    for _ in range(2):
        show.note(flags=session.flags)
        show.add(fake_cycle(0))
    assert (
        said == ["warning (sharp_edge): an edge presses"] and show.moment().flags == session.flags
    )


def test_the_plots_show_the_last_seconds_only():
    show = SessionBridge()
    for i in range(0, 3000, 10):  # 100 s
        show.add(fake_cycle(i, 3001))
    rows = show.history.rows
    assert rows[-1].time - rows[0].time == pytest.approx(20, abs=0.4)  # a cycle of 0.33 s
    curves = show.history.curves()
    assert curves.time[-1] == rows[-1].time and len(curves.time) <= 300
    assert curves is show.history.curves()  # made once a cycle, not once a frame


def test_a_pause_holds_the_session_until_it_goes_on():
    show = SessionBridge()
    show.paused = True
    thread = threading.Thread(target=shown, args=(show, 3))
    thread.start()
    show.step()
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


def test_a_signal_ends_a_pause(monkeypatch):
    """Ctrl-C ends a pause: the loop sets down the held object, and the world must go on for
    this."""
    show = SessionBridge()
    show.paused = True

    def check():
        raise Interrupted

    monkeypatch.setattr("mjtactile.studio.session_bridge.signals.check", check)
    show.on_images()
    assert not show.paused


def test_what_is_asked_for_is_done_by_the_sessions_thread_and_what_raises_is_said():
    show = SessionBridge()
    done = []
    show.session = fake_session()
    show.ask(lambda session: done.append(threading.current_thread().name))
    show.ask(lambda session: 1 / 0)
    show.ask(lambda session: done.append("after"))
    thread = threading.Thread(target=shown, args=(show,), name="session")
    thread.start()
    thread.join()
    assert done == ["session", "after"] and show.said == "ZeroDivisionError: division by zero"


@pytest.mark.parametrize("name", ["restart", "closed"])
def test_another_run_and_a_closed_viewer_end_a_world_that_waits_and_retreat_from_a_real_one(name):
    show = SessionBridge()
    getattr(show, name).set()
    with pytest.raises(RestartRequested):
        show.add(fake_cycle(0))
    show.session = fake_session(host_timeout=0.25)
    show.add(fake_cycle(0))  # goes on: the supervisor opens the hand first
    assert len(show.session.reasons) == 1
    with pytest.raises(RestartRequested):  # nothing moves yet
        show.add_reference("flat", [], [])


def test_the_red_button_makes_it_safe_and_ends_a_pause():
    show = SessionBridge()
    show.session = fake_session()
    show.paused = True
    show.halt()
    assert show.session.reasons == [RED_BUTTON] and not show.paused
    with pytest.raises(DeviceError, match="red button"):  # nothing moves yet, which could retreat
        show.add_reference("rest", [], [])


def test_only_a_world_that_waits_may_be_paused():
    show = SessionBridge()
    assert show.may_pause
    show.session = fake_session(host_timeout=0.25)
    assert not show.may_pause


def test_a_grasp_shows_its_scene_and_obeys():
    """A grasp with real physics shows its scene and follows the user.

    The scene's state is the world's. A valve opened from outside changes the pressure. The gripper
    moves to the requested position and squeezes with the requested force. The red button opens
    it.
    """
    show = SessionBridge()
    show.fastest = np.inf
    moments = []

    class CountingObserver(Observer):
        def on_images(self):
            moments.append(show.moment())
            act = actions.get(len(moments))
            if act is not None:
                act()

    def supply():
        for valve in show.session.rig.valves:
            valve.open(500.0)

    actions = {
        3: lambda: setattr(show, "manual_goal", ManualGoal(0.075, 0.01)),
        10: supply,
        20: show.halt,
    }
    with pytest.raises(DeviceError, match=f"stopped safely: {RED_BUTTON}"):
        controller = show.take_over(load_controller("gentle"))
        run_grasp(Scenario(), [show, CountingObserver()], controller=controller, workers=0)
    moments = [moment for moment in moments if moment is not None]
    times = [moment.scene[1][0] for moment in moments]  # MuJoCo's state begins with its time
    np.testing.assert_allclose(np.diff(times), 1 / 30, atol=1e-9)
    pressure = [moment.fingers[0].gauge_pressure for moment in moments]
    # pressure in Pa; an ideal valve
    assert pressure[5] == pytest.approx(1000, abs=20) and pressure[14] == pytest.approx(500, abs=1)
    assert moments[5].fingers[0].temperature == pytest.approx(293.15, abs=5)
    felt = moments[5].fingers[0]
    # tracks of sensing, against an independent search
    known = followed(felt.image, felt.tracks)
    found = find_ellipses(felt.image)
    order = [
        int(np.argmin(np.linalg.norm(found.center_px - center, axis=1)))
        for center in known.center_px
    ]
    assert sorted(order) == list(range(len(found)))
    # px: where a fit began is a tenth of its sd
    np.testing.assert_allclose(known.center_px, found.center_px[order], atol=0.02)
    assert followed(moments[6].fingers[0].image, felt.tracks) is None  # another image's
    state = [moment.session for moment in moments]
    # 40 mm/s for half a second, less its start
    assert state[18].lift_height > 0.004 and state[18].phase == "approach"
    assert (
        state[-1].state == "safe"
        and state[-1].lift_height < 1e-3
        and state[-1].opening > state[21].opening + 0.005
    )
