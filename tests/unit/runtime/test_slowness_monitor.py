"""Tests of the message about a slow simulation: its cause is the part with the most wall time."""

from types import SimpleNamespace

import pytest

from mjtactile.rig.workload import Workload
from mjtactile.runtime.slowness_monitor import SlownessMonitor


def messages(factor, *, physics=0.0, rendering=0.0, perception=0.0, shapes=False, **sizes):
    """Return messages of a run of 20 s; the parts are fractions of the wall time."""
    clock = SimpleNamespace(now=0.0)
    found = []
    default = {"contacts": 5, "geoms": 1, "elements": 0, "vertices": 286} | sizes

    def load():
        return Workload(physics * clock.now, rendering * clock.now, **default)

    monitor = SlownessMonitor(load, found.append, lambda: clock.now, contact_shapes=shapes)
    for _ in range(200):
        clock.now += 0.1
        monitor.on_images()
        monitor.add(
            SimpleNamespace(
                time=factor * clock.now, perception_ms=100 * perception, controller_ms=1.0
            )
        )
    return found


def test_a_run_in_real_time_has_no_message():
    assert messages(0.5, physics=0.9) == []


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (
            {"physics": 0.9, "contacts": 94, "geoms": 16},
            [
                "0.09 x real time; physics takes 90 %",
                "16 geoms near the membranes, 94 contact points",
                "-mesh",
            ],
        ),
        ({"physics": 0.8, "elements": 700}, ["a soft object of 700 elements"]),
        ({"rendering": 0.6, "physics": 0.3}, ["rendering takes 60 %", "--effects=-images"]),
        ({"perception": 0.7, "shapes": True}, ["perception takes 70 %", "--contact-shapes"]),
        ({"perception": 0.7}, ["markers and forces", "--workers"]),
    ],
)
def test_a_slow_run_reports_its_slowest_part_once(given, words):
    (text,) = messages(0.09, **given)
    assert all(word in text for word in words), text


def test_many_geoms_are_reported_as_a_cause():
    (many,) = messages(0.1, physics=0.9, geoms=16)
    (one,) = messages(0.1, physics=0.9)
    assert "in place of these geoms" in many
    assert "in place of" not in one
