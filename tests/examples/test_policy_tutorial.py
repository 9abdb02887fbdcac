"""Test of the tutorial from recordings to a policy: its code runs unchanged on an export."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mjtactile
from mjtactile.export.episode import find_episodes
from mjtactile.export.lerobot import dataset
from mjtactile.recording.writer import Recorder
from tests.fake_run import fake_cycle

CHECKOUT = Path(__file__).resolve().parents[2]


def record(folder):
    """Record a synthetic grasp that closes at its start and rises after 0.4 of its time."""
    with Recorder(folder, {"sensor": "dense", "object": "egg"}) as recorder:
        for i in range(60):
            cycle = fake_cycle(i)
            opening = 0.05 - 2e-4 * min(i, 15)
            sent = replace(cycle.sent, opening=opening, lift_height=1e-3 * max(i - 24, 0))
            object.__setattr__(cycle, "sent", sent)
            recorder.add(cycle)


def test_the_tutorial_fits_the_recorded_actions(tmp_path, monkeypatch):
    """Two equal synthetic grasps. A fit explains their actions better than the mean action: the
    bound of half its error is far from both."""
    pytest.importorskip("sklearn")
    for name in "ab":
        record(tmp_path / "runs" / name)
    (tmp_path / "data").mkdir()
    dataset.write(find_episodes(tmp_path / "runs"), tmp_path / "data/teacher", images="none")
    page = (CHECKOUT / "docs/tutorials/policy.md").read_text()
    monkeypatch.chdir(tmp_path)
    exec(page.split("```python\n")[1].partition("```")[0], {})
    policy = mjtactile.load_policy(tmp_path / "policy.npz")
    data = mjtactile.policy_data(tmp_path / "runs/a")
    found = np.array([policy(row) for row in data.observations])
    error = np.sqrt(np.mean((found - data.actions) ** 2))
    assert error < np.sqrt(np.mean((data.actions - data.actions.mean(axis=0)) ** 2)) / 2
