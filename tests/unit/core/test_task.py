"""Tests of task files: errors are reported, and samples depend on the seed alone."""

import math
import tomllib
from dataclasses import fields, replace

import pytest

from mjtactile.core import resources
from mjtactile.core.config_fields import entries
from mjtactile.core.errors import InputError
from mjtactile.core.task import Task, load_task
from mjtactile.core.task_sections import (
    Disturbance,
    GoalSettings,
    ObjectRandomization,
    SuccessCriteria,
)
from mjtactile.core.types import TaskGoal

NAMES = resources.names("models/tasks", ".toml")


@pytest.mark.parametrize("name", NAMES)
def test_shipped_tasks_are_read_and_have_a_description(name):
    task = load_task(name)
    assert task.name == name and task.about and task.version
    sampled = task.sample(3, 2)
    assert sampled == task.sample(3, 2)
    assert task.is_plain or sampled.values != task.sample(4, 2).values


def test_lift_is_unchanged_and_its_file_has_every_field():
    """The task lift is unchanged and its file shows every field.

    Every earlier result was of this task: no parameter is sampled, and no disturbance occurs.
    """
    task = load_task("lift")
    assert task.is_plain and task.goal.task_goal() == TaskGoal() and task.time_limit == 60.0
    assert task == replace(Task("lift", ()), about=task.about, version=task.version)
    text = resources.find("lift", "models/tasks", ".toml").read_text()
    complete = "\n".join(
        line.removeprefix("# ") for line in text.splitlines() if "=" in line or "[" in line
    )
    keys = {
        entry.key
        for kind in (GoalSettings, ObjectRandomization, SuccessCriteria)
        for entry in entries(kind).values()
    }
    assert all(f"{key} = " in complete for key in keys)


def test_samples_are_within_their_range_in_the_units_of_the_file():
    table = tomllib.loads(resources.find("pour", "models/tasks", ".toml").read_text())
    task = load_task("pour")
    for seed in range(50):
        sampled = task.sample(seed, 2)
        low, high = table["object"]["mass_g"]
        assert low <= sampled.values["task.mass_g"] <= high
        assert sampled.mass == pytest.approx(1e-3 * sampled.values["task.mass_g"], rel=1e-5)
        low, high = table["disturbance"][0]["final_mass_g"]
        assert low <= sampled.values["task.fill1.final_mass_g"] <= high
        # loads are within the grip force: largest of both, two fingers
        heaviest = max(sampled.mass, sampled.events[0].values["mass"])
        assert (
            heaviest * 9.81 / (2 * sampled.friction)
            <= table["object"]["required_grip_max_N"] + 1e-9
        )


def test_masses_are_log_uniform():
    masses = [load_task("weigh").object.mass]
    task = Task("mine", (), object=ObjectRandomization(mass=masses[0]))
    sampled = [math.log(task.sample(seed, 2).mass) for seed in range(400)]
    low, high = (math.log(value) for value in masses[0])
    assert sum(sampled) / 400 == pytest.approx(
        (low + high) / 2, abs=4 * (high - low) / 12**0.5 / 20
    )


def test_an_added_disturbance_does_not_change_the_others():
    task = load_task("bump")
    assert (
        task.sample(7, 2).events[0]
        == replace(task, disturbances=task.disturbances[:1]).sample(7, 2).events[0]
    )


def test_required_grip_is_coulombs_at_the_largest_load():
    sampled = load_task("shake").sample(5, 2)
    shaken = sampled.events[0].values["acceleration"]
    assert sampled.need(0.05, 0.5, 2) == pytest.approx(0.05 * (9.81 + shaken))
    assert sampled.need(0.05, 0.5, 4) == pytest.approx(0.05 * (9.81 + shaken) / 2)


def test_required_grip_includes_the_second_object_and_the_path():
    sampled = load_task("stack").sample(5, 2)
    added = sampled.events[0].values["added_mass"]
    assert sampled.need(0.04, 0.5, 2) == pytest.approx((0.04 + added) * 9.81)
    carried = load_task("carry").sample(5, 2)
    load = carried.path.max_load(9.81)
    assert load > 10 and carried.need(0.04, 0.5, 2) == pytest.approx(0.04 * load)


def test_a_direction_of_the_file_is_that_of_every_seed(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        '[[disturbance]]\nkind = "push"\nstart_s = [0, 1]\nduration_s = [1, 1]\nimpulse_N_s = [0, 1]\n'
        "direction = [0, 0.6, -0.8]\n"
    )
    task = load_task(path)
    for seed in (1, 2):
        assert task.sample(seed, 2).events[0].direction == pytest.approx((0, 0.6, -0.8))


def test_required_grip_is_that_of_the_lowest_friction():
    sampled = load_task("wet").sample(5, 2)
    assert sampled.need(0.04, 0.8, 2) == pytest.approx(0.04 * 9.81 / (2 * 0.35))


def test_start_of_a_handover_is_a_pull_of_0_3_newton():
    sampled = load_task("hand-over").sample(5, 2)
    pull = sampled.events[1]
    force = (sampled.pulls() - pull.start) / pull.duration * pull.values["force"]
    assert force == pytest.approx(0.3) and math.isnan(load_task("lift").sample(5, 2).pulls())


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("[tell]", ["tell: unknown section", "goal"]),
        ("[goal]\nhold_time_s = 0", ["goal.hold_time_s", "0 is outside 0.1"]),
        ("[object]\nmass_g = 5", ["object.mass_g"]),
        ("[object]\nbreak_force_factor = [2, 3]", ["break_force_factor", "requires friction"]),
        (
            '[[disturbance]]\nkind = "rain"\nstart_s = [0, 1]\nduration_s = [1, 1]',
            ["disturbance[0].kind", "fill"],
        ),
        (
            '[[disturbance]]\nkind = "push"\nstart_s = [0, 1]\nduration_s = [1, 1]',
            ["impulse_N_s", "is missing"],
        ),
        (
            '[[disturbance]]\nkind = "push"\nstart_s = [0, 1]\nduration_s = [1, 1]\nimpulse_N_s = [0, 1]\n'
            "rate_Hz = [1, 2]",
            ["disturbance[0].rate_Hz"],
        ),
        (
            '[[disturbance]]\nkind = "friction"\nstart_s = [0, 1]\nduration_s = [1, 1]',
            ["final_friction", "is missing"],
        ),
        (
            '[[disturbance]]\nkind = "push"\nstart_s = [0, 1]\nduration_s = [1, 1]\nimpulse_N_s = [0, 1]\n'
            "direction = [0, 0, 0]",
            ["disturbance[0].direction", "[0, 0, 0] is not a direction"],
        ),
        (
            '[[disturbance]]\nkind = "fill"\nstart_s = [0, 1]\nduration_s = [1, 1]\nfinal_mass_g = [5, 9]\n'
            "direction = [0, 0, 1]",
            ["disturbance[0].direction", "unknown field"],
        ),
        (
            '[[disturbance]]\nkind = "stack"\nstart_s = [0, 1]\nduration_s = [1, 1]\nobject_size_mm = [9, 9]',
            ["object_mass_g", "is missing"],
        ),
        ("[[waypoint]]\nspeed_mm_s = [5, 5]", ["waypoint[0].x_mm", "no motion"]),
        ("[[waypoint]]\nx_mm = [5, 5]\nroll_deg = [5, 5]", ["waypoint[0].roll_deg", "unknown"]),
        (
            "[goal]\nhold_time_s = 1\n[[waypoint]]\nx_mm = [200, 200]",
            ["goal.hold_time_s", "1 s is less than the duration of the path, up to 2.0 s"],
        ),
        ("[success]\nplace_within_mm = 5", ["success.place_within_mm", "requires a waypoint"]),
        ("[success]\nstacked = true", ["success.stacked", "requires a disturbance of kind stack"]),
        (
            '[object]\nliquid_fill_percent = [30, 50]\n[[disturbance]]\nkind = "fill"\nstart_s = [0, 1]\n'
            "duration_s = [1, 1]\nfinal_mass_g = [5, 9]",
            ["object.liquid_fill_percent", "not possible with a disturbance of kind fill"],
        ),
        ("[object]\nmass_g = [50, 20]", ["object.mass_g", "lower limit above its upper limit"]),
    ],
)
def test_an_error_is_one_line_with_file_field_value_and_choices(tmp_path, text, parts):
    path = tmp_path / "mine.toml"
    path.write_text(text + "\n")
    with pytest.raises(InputError) as caught:
        load_task(path)
    reported = str(caught.value)
    assert "\n" not in reported and all(part in reported for part in ["mine.toml", *parts]), (
        reported
    )


def test_the_robot_receives_only_the_contents_of_the_file():
    goal = load_task("place").goal.task_goal()
    assert (goal.lift_height, goal.place_height) == (0.06, 0.02)
    assert {field.name for field in fields(TaskGoal)} == {
        field.name for field in fields(GoalSettings)
    }
    assert {field.name for field in fields(Disturbance)}.isdisjoint(fields(TaskGoal))
