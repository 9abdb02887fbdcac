"""Benchmark of many worlds: its tables, and the scene with MuJoCo's `<tactile>` sensor."""

import json
from dataclasses import asdict

import numpy as np
import pytest

pytest.importorskip("mujoco_warp")

from benchmarks.gpu.creep import creep
from benchmarks.gpu.memory import array_memory
from benchmarks.gpu.pairs import SEED, Grasp, Pair, PairedGrasps, _next_actions
from benchmarks.gpu.presses import press_objects
from benchmarks.gpu.run import _failures, table
from benchmarks.gpu.tactile_sensor import speeds

PAIR = {
    "object": "random",
    "pairs": 50,
    "same_outcome": 0.98,
    "held_cpu": 48,
    "held": 49,
    "force_difference_median_N": 0.004,
    "force_difference_p95_N": None,
}


def test_without_a_gpu_the_table_states_that_speed_was_not_measured():
    row = {**PAIR, "force_difference_p95_N": 0.05}
    text = table({"device": "CPU", "is_gpu": False, "pairs": [row], "skipped": []})
    assert "| random | 50 | 48 / 49 | 98 | 4.0 / 50.0 |" in text
    assert text.endswith("speed was not measured.\n")


def test_rejected_solutions_of_random_actions_are_in_the_table():
    row = {"worlds": 32, "control_steps": 9984, "touching": 800, "rejected": 3, "failed": 1}
    slow = {"step_ms": 4.17, "masses_g": [10.0, 300.0], "speed_um_s": [0.01, 0.0204]}
    text = table(
        {
            "device": "CPU",
            "is_gpu": False,
            "pairs": [PAIR | {"force_difference_p95_N": 0.05}],
            "failures": [row],
            "creep": [slow],
            "memory": [{"worlds": 4096, "memory_GB": 0.78}],
            "skipped": [],
        }
    )
    assert "9,984 control steps, 800 of them with contact; 3 with a rejected solution, 1 w" in text
    assert "| 4.17 | 10 to 300 | 0.020 |" in text and "Arrays of 4096 worlds: 0.78 GB." in text


@pytest.mark.slow(20)
def test_random_actions_are_counted():
    found = _failures(4, 40, "cpu")
    assert (found["control_steps"], found["failed_fraction"]) == (40, 0.0)


def test_unmeasured_parts_are_named():
    speed = {"worlds": 4096, "control_steps_per_s": 1e5, "memory_GB": 2.0, "held_N": 0.6}
    text = table(
        {
            "device": "some GPU",
            "is_gpu": True,
            "pairs": [{**PAIR, "force_difference_median_N": None}],
            "speed": [speed],
            "skipped": ["failures"],
        }
    )
    assert "| 4096 | 100,000 | 2.00 | 0.600 |" in text
    assert text.endswith("Not measured, no time left: failures.\n")


def test_pairs_of_an_interrupted_run_are_not_run_again(tmp_path):
    file = tmp_path / "pairs.jsonl"
    outcomes = ["held", "held", "held", "dropped"]
    pairs = [
        Pair("egg", SEED + k, "held", outcome, 0.6, 0.6 + 1e-3 * k)
        for k, outcome in enumerate(outcomes)
    ]
    lines = [json.dumps(asdict(pair)) + "\n" for pair in pairs]
    file.write_text("".join(lines) + lines[0][:20])  # the last line was cut off
    paired = PairedGrasps("egg", "no device", file, batch=2, workers=1)
    found = paired.run(4, notify=print)
    assert (found["pairs"], found["held_cpu"], found["held"]) == (4, 4, 3)
    assert found["different"] == [[SEED + 3, "held", "dropped"]]
    assert found["force_difference_median_N"] == pytest.approx(1.5e-3)
    assert not PairedGrasps("block", "no device", file, batch=2, workers=1).done


def test_a_world_that_missed_a_command_follows_the_next_command():
    """At 50 mm/s and 30 Hz, an action of 1 is 1.667 mm."""
    actions = np.zeros((4, 3))
    grasp = Grasp(actions, np.array([[0.030, 0.001], [0.029, 0.002]]), 0.6, "held")
    found = _next_actions([grasp], 1, np.array([0.0295]), np.array([0.001]))
    assert found[0] == pytest.approx([-0.3, 0.0, 0.6], abs=1e-6)
    assert not _next_actions([grasp], 2, np.array([0.0295]), np.array([0.001])).any()


@pytest.mark.slow(60)
def test_the_tactile_sensor_of_mujoco_reports_a_pressure_on_the_same_gripper():
    """Servos of 1 N/mm press pads and membranes on the egg.

    MuJoCo computes depth / (50 mm - depth), which is 0.02 at 1 mm.
    """
    found = speeds(1, "cpu", 150)
    assert found["tactile_max_pressure"] == pytest.approx(0.02, abs=0.005)
    assert 0.3 < found["membranes_force_N"] < 2.0


@pytest.mark.slow(20)
def test_random_presses_have_the_sticking_stiffness_of_the_cpu():
    """Contacts of two to 40 nodes that changed in the approach.

    One node more or fewer changes the torsional stiffness by 2 to 20 %. Conjugate gradients leave
    0.1 %, and the position of the pressure's center between two nodes 2 %.
    """
    found = press_objects("ball", 10, "cpu")
    assert found["presses"] == 10 and found["unsettled"] == 0
    assert found["rms"]["force"] < 0.005
    assert found["rms"]["shear"] < 0.003
    assert found["rms"]["torsion"] < 0.01


@pytest.mark.slow(10)
def test_boxes_held_by_friction_do_not_creep():
    """Required: 1 um/s."""
    found = creep(4.17e-3, "cpu", masses=(0.01, 0.3), phases=(0.6, 1.0, 0.6))
    weight = np.array(found["masses_g"]) * 9.81e-3
    assert found["shear_N"] == pytest.approx(weight / 2, rel=0.005)
    assert max(found["speed_um_s"]) < 1.0 and found["rejected"] == 0


def test_memory_is_that_of_the_arrays_that_are_kept():
    import warp as wp

    def make():
        wp.zeros(10**6, dtype=float, device="cpu")  # not kept
        return wp.zeros(10**6, dtype=float, device="cpu")

    assert array_memory(make) == pytest.approx(4e-3, rel=0.01)
