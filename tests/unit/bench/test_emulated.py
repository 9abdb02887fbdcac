"""Test that the table of emulated grasps matches its rows."""

from benchmarks.rig.emulated_grasps import table


def row(name, outcome, hold=0.4):
    return {"object": name, "seed": 0, "hold_N": hold, "outcome": outcome, "reason": ""}


def test_a_fault_of_the_rig_is_reported_and_is_not_held():
    rows = [row("egg", "held", 0.2)] * 3 + [row("vial", "held")] * 2 + [row("vial", "fault", None)]
    text = table({"grasps": rows, "slow": 4.0})
    assert "| egg |  | 3 of 3 (44-100 %) | 0 | 0.20 |" in text  # Wilson's interval
    assert "| vial |  | 2 of 3 (21-94 %) | 1 | 0.40 |" in text
    assert "| all | 20 of 20 | 5 of 6 (44-97 %) | 1 | 0.20 |" in text
    assert "1/4 of real time" in text and "real time" not in table({"grasps": rows, "slow": 1.0})
