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
    """Return a stand-in session on a rig without a scene, which records the reason of a safe
    stop."""
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


def shown(bridge, count=1):
    for i in range(count):
        bridge.on_images()
        bridge.add(fake_cycle(i), force_normal_true=[0.1, 0.2])


def test_a_cycle_is_shown_with_its_ground_truth():
    bridge = SessionBridge()
    shown(bridge, 3)
    snapshot = bridge.snapshot()
    assert snapshot.number == 2 and bridge.history.rows[-1].true == (0.1, 0.2)
    lines = finger_lines(snapshot.fingers[1])
    assert lines[0].startswith(f"normal {snapshot.fingers[1].touch.force_normal:+.3f} N")
    assert "ground truth +0.200 N" in lines


def test_a_flag_is_reported_once_and_shown_next_to_the_values():
    text = []
    bridge = SessionBridge(notify=text.append)
    session = fake_session()
    session.flags = {"sharp_edge": "an edge presses"}
    bridge.start(session)
    for _ in range(2):
        bridge.note(flags=session.flags)
        bridge.add(fake_cycle(0))
    assert (
        text == ["warning (sharp_edge): an edge presses"]
        and bridge.snapshot().flags == session.flags
    )


def test_the_plots_show_the_last_seconds_only():
    bridge = SessionBridge()
    for i in range(0, 3000, 10):  # 100 s
        bridge.add(fake_cycle(i, 3001))
    rows = bridge.history.rows
    assert rows[-1].time - rows[0].time == pytest.approx(20, abs=0.4)  # a cycle of 0.33 s
    curves = bridge.history.curves()
    assert curves.time[-1] == rows[-1].time and len(curves.time) <= 300
    assert curves is bridge.history.curves()  # created once a cycle, not once a frame


def test_a_pause_blocks_the_session_until_resumed():
    bridge = SessionBridge()
    bridge.paused = True
    thread = threading.Thread(target=shown, args=(bridge, 3))
    thread.start()
    bridge.step()
    until(lambda: bridge.latest is not None)
    time.sleep(0.1)
    assert bridge.latest.number == 0
    bridge.step()
    until(lambda: bridge.latest.number == 1)
    time.sleep(0.1)
    assert bridge.latest.number == 1
    bridge.paused = False
    thread.join(10)
    assert bridge.latest.number == 2


def test_a_signal_ends_a_pause(monkeypatch):
    """Ctrl-C ends a pause: the loop sets down the held object, which requires simulation steps."""
    bridge = SessionBridge()
    bridge.paused = True

    def check():
        raise Interrupted

    monkeypatch.setattr("mjtactile.studio.session_bridge.signals.check", check)
    bridge.on_images()
    assert not bridge.paused


def test_requests_run_in_the_sessions_thread_and_errors_are_reported():
    bridge = SessionBridge()
    done = []
    bridge.session = fake_session()
    bridge.ask(lambda session: done.append(threading.current_thread().name))
    bridge.ask(lambda session: 1 / 0)
    bridge.ask(lambda session: done.append("after"))
    thread = threading.Thread(target=shown, args=(bridge,), name="session")
    thread.start()
    thread.join()
    assert (
        done == ["session", "after"]
        and bridge.last_message == "ZeroDivisionError: division by zero"
    )


@pytest.mark.parametrize("name", ["restart", "closed"])
def test_another_run_or_a_closed_viewer_ends_simulated_and_retreats_real_rigs(name):
    bridge = SessionBridge()
    getattr(bridge, name).set()
    with pytest.raises(RestartRequested):
        bridge.add(fake_cycle(0))
    bridge.session = fake_session(host_timeout=0.25)
    bridge.add(fake_cycle(0))  # continues: the supervisor opens the gripper first
    assert len(bridge.session.reasons) == 1
    with pytest.raises(RestartRequested):  # no motion yet
        bridge.add_reference("flat", [], [])


def test_the_red_button_makes_the_rig_safe_and_ends_a_pause():
    bridge = SessionBridge()
    bridge.session = fake_session()
    bridge.paused = True
    bridge.halt()
    assert bridge.session.reasons == [RED_BUTTON] and not bridge.paused
    with pytest.raises(DeviceError, match="red button"):  # no device is running that could retreat
        bridge.add_reference("rest", [], [])


def test_only_a_simulated_world_can_be_paused():
    bridge = SessionBridge()
    assert bridge.may_pause
    bridge.session = fake_session(host_timeout=0.25)
    assert not bridge.may_pause


def test_a_grasp_shows_its_scene_and_obeys():
    """A grasp with real physics shows its scene and follows the user.

    The scene's state is the world's. A valve opened from outside changes the pressure. The gripper
    moves to the requested position and squeezes with the requested force. The red button opens
    it.
    """
    bridge = SessionBridge()
    bridge.fastest = np.inf
    snapshots = []

    class CountingObserver(Observer):
        def on_images(self):
            snapshots.append(bridge.snapshot())
            act = actions.get(len(snapshots))
            if act is not None:
                act()

    def supply():
        for valve in bridge.session.rig.valves:
            valve.open(500.0)

    actions = {
        3: lambda: setattr(bridge, "manual_goal", ManualGoal(0.075, 0.01)),
        10: supply,
        20: bridge.halt,
    }
    with pytest.raises(DeviceError, match=f"stopped safely: {RED_BUTTON}"):
        controller = bridge.take_over(load_controller("gentle"))
        run_grasp(Scenario(), [bridge, CountingObserver()], controller=controller, workers=0)
    snapshots = [snapshot for snapshot in snapshots if snapshot is not None]
    times = [snapshot.scene[1][0] for snapshot in snapshots]  # MuJoCo's state starts with its time
    np.testing.assert_allclose(np.diff(times), 1 / 30, atol=1e-9)
    pressure = [snapshot.fingers[0].gauge_pressure for snapshot in snapshots]
    # pressure in Pa; an ideal valve
    assert pressure[5] == pytest.approx(1000, abs=20) and pressure[14] == pytest.approx(500, abs=1)
    assert snapshots[5].fingers[0].temperature == pytest.approx(293.15, abs=5)
    estimated = snapshots[5].fingers[0]
    # tracks of sensing, against an independent search
    known = followed(estimated.image, estimated.tracks)
    found = find_ellipses(estimated.image)
    order = [
        int(np.argmin(np.linalg.norm(found.center_px - center, axis=1)))
        for center in known.center_px
    ]
    assert sorted(order) == list(range(len(found)))
    # px: the start of a fit contributes a tenth of its sd
    np.testing.assert_allclose(known.center_px, found.center_px[order], atol=0.02)
    assert followed(snapshots[6].fingers[0].image, estimated.tracks) is None  # another image's
    state = [snapshot.session for snapshot in snapshots]
    # 40 mm/s for half a second, less its start
    assert state[18].lift_height > 0.004 and state[18].phase == "approach"
    assert (
        state[-1].state == "safe"
        and state[-1].lift_height < 1e-3
        and state[-1].opening > state[21].opening + 0.005
    )
