"""Tests of fidelity: the cheapest measured setting that meets the request, and a clear report if
none does."""

import json

import pytest

from mjtactile.core.effect_names import Effect
from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.sim.effects import fidelity
from mjtactile.sim.effects.fidelity import DEFAULT_FORCE_ERROR, Fidelity
from mjtactile.sim.rig import build_sim_rig
from mjtactile.sim.sensor.quasistatic_geoms import QS_GRID


def _row(mesh, error, cost):
    return {
        "mesh": mesh,
        "timestep_ms": 4.0,
        "tolerance": 1e-7,
        "force_error_N": error,
        "surface_error_um": 10.0,
        "force_noise_N": 1e-4,
        "ms_per_s": cost,
    }


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "measured.json"
    rows = [
        _row([9, 7], 0.04, 200.0),
        _row([11, 9], 0.015, 500.0),
        _row([12, 9], 0.012, 600.0),
        _row([21, 17], 0.003, 4000.0),
    ]
    path.write_text(
        json.dumps({"stamp": {"machine": "m", "mujoco": "4", "date": "d"}, "rows": rows})
    )
    return path


@pytest.mark.parametrize(
    ("asked", "mesh"), [(0.05, (9, 7)), (0.02, (11, 9)), (0.015, (11, 9)), (0.0031, (21, 17))]
)
def test_the_cheapest_sufficient_level_is_chosen(table, asked, mesh):
    assert Fidelity.for_force_error(asked, table).mesh == mesh


def test_an_unreachable_accuracy_reports_the_best_level(table):
    best = Fidelity.for_force_error(0.001, table)
    assert not best.met
    assert best.mesh == (21, 17)
    assert "0.003" in best.basis


@pytest.mark.parametrize("asked", ["1e-12N", "0N", "-0.1N", "infN", "nanN", "0.02"])
def test_an_accuracy_out_of_range_is_refused_in_one_line(table, asked):
    with pytest.raises(InputError, match=r"is not an accuracy of at least 0\.0001 N"):
        Fidelity.parse(asked, table)


def test_real_time_chooses_the_most_accurate_level_with_reserve(table):
    # 600 ms/s is 1.67 x real time, 4000 is not; the margin is REAL_TIME_MARGIN
    assert Fidelity.for_real_time(table).mesh == (12, 9)


def test_effects_are_chosen_for_the_requested_accuracy_only(table):
    """Real time with a fine mesh must not switch on effects that only that mesh's small error calls
    for."""
    assert Fidelity.for_force_error(0.02, table).asked == 0.02
    assert Fidelity.for_force_error(1e-4, table).asked == 1e-4  # also if no level reaches it
    assert Fidelity.for_real_time(table).asked == DEFAULT_FORCE_ERROR


def test_basis_names_the_measurement_and_the_machine(table):
    basis = Fidelity.parse("0.02N", table).basis
    assert "11x9" in basis
    assert "m, MuJoCo 4, d" in basis


@pytest.mark.parametrize("text", ["0.02", "fast", "-1N", "nanN", "infN", "0N", ""])
def test_invalid_accuracies_are_refused(table, text):
    with pytest.raises(InputError, match="realtime"):
        Fidelity.parse(text, table)


def test_a_table_is_read_back(table):
    row = Fidelity.for_force_error(0.02, table)
    assert fidelity.row_from_json(row.summary()) == fidelity.row_from_json(
        _row([11, 9], 0.015, 500.0)
    )


@pytest.mark.parametrize(
    "text", ["{}", "no json", '{"rows": [], "stamp": {"machine": "", "mujoco": "", "date": ""}}']
)
def test_a_broken_table_is_refused(tmp_path, text):
    path = tmp_path / "broken.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"broken\.json"):
        Fidelity.for_real_time(path)


def test_shipped_table_can_be_read_and_orders_by_mesh():
    rows, _ = fidelity.load_table()
    assert len(rows) > 5
    # second order in the mesh: the finest measured mesh beats the coarsest by far more than any
    # noise
    by_mesh = sorted(rows, key=lambda row: row.mesh[0] * row.mesh[1])
    assert by_mesh[-1].force_error < 0.5 * by_mesh[0].force_error
    assert by_mesh[-1].cost > by_mesh[0].cost


@pytest.mark.parametrize(
    ("accuracy", "effects", "grasped", "mesh"),
    [
        ("0.03N", "auto", "egg", False),
        ("0.03N", "-friction", "egg", False),
        ("0.03N", "+mesh", "egg", True),
        ("realtime", "auto", "egg", True),
        ("", "auto", "egg", True),
        ("0.03N", "auto", "vial", True),  # it has edges: its error was not measured
        ("0.0001N", "auto", "egg", True),  # no level is sufficient, the finest mesh is closest
    ],
)
def test_a_round_object_may_use_the_quasistatic_membrane(
    monkeypatch, accuracy, effects, grasped, mesh
):
    """For a round object the quasi-static membrane may meet the requested force error, and the rig
    reports the choice."""
    membrane = fidelity.row_from_json(_row([21, 16], 0.01, 10.0) | {"effects": "-mesh"})
    monkeypatch.setattr(fidelity, "load_membranes", lambda: [membrane])
    rig = build_sim_rig(Scenario(object=grasped, accuracy=accuracy, effects=effects))
    rig.close()
    assert (Effect.MESH in rig.scene.effects) is mesh
    if not mesh:
        assert tuple(rig.simulated["mesh"]) == QS_GRID
    assert (Effect.FRICTION in rig.scene.effects) is (effects != "-friction")
