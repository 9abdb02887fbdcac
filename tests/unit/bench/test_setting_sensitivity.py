"""Tests of the table of parameter sensitivities."""

from benchmarks.setting_sensitivity import table


def test_parameters_without_an_effect_are_counted_and_left_out():
    same = {"force_N": 0.0, "bar": 1.0, "markers": 0.0, "reported": 0}
    less = {**same, "name": "prior.friction", "force_N": 7e-4}
    more = {**same, "name": "prior.friction", "force_N": 1.2e-3, "reported": 1}
    quiet = {**same, "name": "min_detected", "force_N": 0.4e-3, "reported": 2}
    lines = table({"rows": [less, more, quiet, quiet]}).splitlines()
    assert lines[0].startswith("2 parameters; 1 change little or nothing here and are left out (")
    # columns without a change are left out
    assert lines[2:] == [
        "| parameter | default | force, mN | images |",
        "|---|---|---|---|",
        "| `prior.friction` | 0.8 | 0.7/1.2 | 0/1 |",
    ]
