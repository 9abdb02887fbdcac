"""The gripper without touch closes by its servo's current alone."""

from controllers import touchless
from mjtactile.types import Command, GripperState, Observation


def observe(command: Command, *, opening=0.05, effort=0.0, lift=0.0, time=0.0) -> Observation:
    return Observation(time, 1 / 30, (), GripperState(opening, 0.0, effort, lift), (), command)


def test_touchless_completes_a_grasp_by_effort_and_height():
    command = Command(0.05, 0.0, 0.0, "approach", {})
    observed = []
    opening = 0.05
    lift = 0.0
    for k in range(900):
        effort = max(0.0, 0.04 - opening) * 300  # an object of 40 mm with a stiffness of 300 N/m
        command = touchless.step(
            observe(command, opening=opening, effort=effort, lift=lift, time=k / 30)
        )
        opening = command.opening
        lift = command.lift_height
        observed += [command.phase] if not observed or observed[-1] != command.phase else []
        if command.phase == "done":
            break
    assert observed == ["approach", "regulate", "lift", "hold", "lower", "release", "done"]
    assert lift == 0 and opening > 0.045


def test_one_noisy_reading_does_not_stop_the_jaws():
    """A single reading of twice the effort does not stop the jaws: a third of it enters the
    average."""
    command = Command(0.05, 0.0, 0.0, "approach", {})
    for k in range(30):
        command = touchless.step(
            observe(command, opening=command.opening, effort=1.2 if k == 10 else 0.0, time=k / 30)
        )
    assert command.phase == "approach" and command.opening < 0.041


def test_the_effort_of_motion_is_not_grip_force():
    """The effort of motion does not count as grip.

    Contact is at 40 mm with 300 N/m, and motion alone takes 0.5 N. The jaws stop at 0.6 N of grip,
    plus the increase during the averaging time.
    """
    command = Command(0.05, 0.0, 0.0, "approach", {})
    for k in range(200):
        effort = 0.5 + max(0.0, 0.04 - command.opening) * 300
        command = touchless.step(
            observe(command, opening=command.opening, effort=effort, time=k / 30)
        )
        if command.phase != "approach":
            break
    assert command.phase == "regulate" and 0.6 < (0.04 - command.opening) * 300 < 1.1
