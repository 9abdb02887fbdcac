"""Tests that `bench speed` times the stated work."""

import pytest

from benchmarks.speed import compare, sensors


def test_balls_lie_on_their_sensors_and_the_others_sleep():
    """Membranes carry the balls at rest, and sensors without a ball sleep.

    The constraint force on the ball's slide joint is its weight.
    """
    world = sensors.scene(2, loaded=True)
    assert world.kinetic_energy < 1e-9 and not any(sensor.is_asleep for sensor in world.sensors)
    # at rest
    assert world.data.qfrc_constraint[world.model.joint("ball1").dofadr[0]] == pytest.approx(
        0.03 * 9.81, rel=1e-3
    )
    assert all(sensor.is_asleep for sensor in sensors.scene(2, loaded=False).sensors)


def test_tables_have_their_rows():
    text = sensors.table(
        [
            {"sensors": 1, "loaded_ms": 1.5, "asleep_ms": 0.05},
            {"sensors": 8, "loaded_ms": 9.0, "asleep_ms": 0.4},
        ]
    )
    assert "| 8 | 9.00 | 0.75 | 0.400 |" in text
    row = {
        "core": {
            "core_ms": {"image to touch": {"hold": 8.0, "alone, held": 5.0}},
            "core_s_per_s": 2.0,
            "import_s": 1.0,
            "references_s": 2.0,
        },
        "loop": [{"factors": {"all": 0.5}}, {"factors": {"all": 0.4}}],
        "help_s": 0.2,
        "grasp_s": 30.0,
    }
    now = row | {"loop": [{"factors": {"all": 1.0}}, {"factors": {"all": 0.8}}], "grasp_s": 15.0}
    text = compare.table(
        {"rounds": [{"before": row, "now": now}], "processor": "a", "load_average": 1.0}
    )
    assert "| image to estimate, ms |" in text and " | 5 | 1.00 |" in text
    assert "| complete grasp | gain |" in text
    assert "| 60 Hz loop, x real time | 0.8 | 2.00 |" in text
    assert "| `mjtactile grasp`, complete, s | 30 | 15 | 2.00 |" in text
