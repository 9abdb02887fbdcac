"""Tests that an interrupted commissioning benchmark resumes after its last grasp and recording."""

import numpy as np
import pytest

from benchmarks.commissioning import commissioning_steps as first_day


def test_finished_grasps_are_not_repeated(tmp_path, monkeypatch):
    made = []

    def grasp(day, sensor, file, seed, where):
        if seed == 2 and 2 not in made:
            made.append(2)
            raise KeyboardInterrupt
        made.append(seed)
        where.mkdir(parents=True)
        return np.array([[0.01 * seed, -0.02], [np.nan, 0.0]])

    monkeypatch.setattr(first_day.Day, "_grasp", grasp)
    day = first_day.Day(tmp_path, lambda _: None)
    with pytest.raises(KeyboardInterrupt):
        day.grasps("dense", day.file, (1, 2, 3))
    found = first_day.Day(tmp_path, lambda _: None).grasps("dense", day.file, (1, 2, 3))
    assert made == [1, 2, 2, 3]
    np.testing.assert_allclose(found["mean_N"], [[0.01, -0.01], [0.02, -0.01], [0.03, -0.01]])
    assert found["worst_N"] == pytest.approx(0.03) and "seconds" in found


def test_finished_recordings_for_fit_are_not_repeated(tmp_path, monkeypatch):
    made = []

    def record(design, stage, recorder, seconds, seed):
        made.append(seed)
        if made == [0, 1]:
            raise KeyboardInterrupt

    monkeypatch.setattr(first_day, "record_stage", record)
    monkeypatch.setattr(first_day, "main", lambda words: 1)
    day = first_day.Day(tmp_path, lambda _: None)
    with pytest.raises(KeyboardInterrupt):
        day.fit()
    with pytest.raises(first_day.MjtactileError, match="exit code 1"):
        first_day.Day(tmp_path, lambda _: None).fit()
    assert made == [0, 1, 1, 2]
