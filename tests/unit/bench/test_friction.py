"""Tests of the frequencies of slip signs by utilization."""

import numpy as np
import pytest

from benchmarks import friction
from benchmarks.friction import EDGES, frequencies, table
from mjtactile.grasp_estimation.slip_signs import MOVES, NONE, SOME


def row(used, sign, friction=0.5, harder=0.0, more=0.0):
    """Return one image at a utilization `used` over the coefficient."""
    found = {"used": used * friction, "friction": friction, "sign": sign, "slid": used * friction}
    return found | {"harder": harder, "more": more}


def test_signs_are_counted_by_the_utilization_over_the_coefficient():
    rows = [row(0.55, NONE)] * 3 + [row(0.55, SOME)] + [row(0.95, MOVES)] + [row(0.95, NONE)]
    found = frequencies([rows, []])
    place = {upper: k for k, upper in enumerate(EDGES[1:])}
    assert found["images"][place[0.6]] == 4 and found["images"][place[1.0]] == 2
    assert found["signs"][place[0.6]] == pytest.approx([0.25, 0.0, 0.0])
    assert found["signs"][place[1.0]] == pytest.approx([0.0, 0.0, 0.5])
    assert np.isnan(found["signs"][place[0.7]]).all()


def test_estimates_need_ten_changes_of_the_grip():
    """Sticking contacts keep their shear: the ratio of both changes is small."""
    few = frequencies([[row(0.5, NONE, harder=0.2, more=0.02)] * 9])["answers"]
    assert few == {"sticking": None, "sliding": None}
    many = frequencies([[row(0.5, NONE, harder=0.2, more=0.02)] * 10])["answers"]
    assert many["sticking"] == pytest.approx([0.1] * 3) and many["sliding"] is None


def test_the_utilization_of_moving_fingers_is_a_measurement_of_friction():
    rows = [row(0.9, MOVES)] * 6 + [row(1.0, MOVES)] * 6 + [row(0.5, NONE)] * 9
    assert frequencies([rows])["slid"] == pytest.approx([0.9, 0.95, 1.0])
    assert frequencies([rows[:5]])["slid"] is None


def test_the_table_states_the_number_of_grasps():
    found = frequencies([[row(0.55, NONE)]]) | {"grasps": 1}
    assert "Grasps: 1, seeds from 61000." in table({"levels": {"mesh": found}})


def test_an_interrupted_run_continues_with_the_stored_grasps(tmp_path, monkeypatch):
    """Unknown changes of the grip are NaN again; the tables are those of one run."""
    started = []

    class Grasp:
        rows = [row(0.55, NONE, harder=np.nan, more=np.nan)] * 2

    def grasp(task, controller, seed, *_):
        started.append((task, controller, seed))
        if len(started) == 20:
            raise KeyboardInterrupt
        return Grasp()

    monkeypatch.setattr(friction, "_grasp", grasp)
    monkeypatch.setattr(friction, "_plot", lambda *_: None)
    with pytest.raises(KeyboardInterrupt):
        friction.run(tmp_path, episodes=3)
    resumed = friction.run(tmp_path, episodes=3, resume=True)
    assert len(started) == 20 + (1 + 4 * 2 * (3 + 1) - 19) and started[19] == started[20]
    images = resumed["levels"]["synthetic touch"]["images"]
    assert sum(images) == 4 * 2 * 3 * 2
    assert resumed["levels"]["synthetic touch"]["answers"] == {"sticking": None, "sliding": None}
