"""Tests of the estimates for a held object against statics, with known forces."""

import math
from dataclasses import asdict

import numpy as np
import pytest

from mjtactile import grasp_estimation
from mjtactile.core.status import Status, StatusCode
from mjtactile.core.types import Slip, SlipState, Touch, Traction

NOISE = 0.003  # sd of each component, N
GRID = np.linspace(-0.01, 0.01, 3)


def touch(fx, fy, normal, state: SlipState = "sticking"):
    """Return the touch of a finger with this force on its membrane, N; `normal` is positive in
    compression."""
    wrench = np.array([fx, fy, -normal, 0.0, 0.0, 0.0])
    cov = np.diag([NOISE**2] * 3 + [1e-8] * 3)
    traction = Traction(GRID, GRID, np.zeros((3, 3, 3)), wrench, cov, 1000.0, "made up")
    slip = Slip(state, np.zeros(2), 0.0, 1.0)
    return Touch(0.0, 0.01, normal, NOISE, True, traction=traction, slip=slip)


UNKNOWN = Touch(0.0, 0.01, math.nan, math.nan, False, status=Status(StatusCode.OTHER, "too dark"))


@pytest.mark.parametrize("mass", [0.005, 0.06, 0.3])
@pytest.mark.parametrize("acceleration", [0.0, 2.0])
def test_a_hanging_object_is_weighed_for_any_finger_axes(mass, acceleration):
    """A hanging object has the right weight for any finger axes.

    The fingers have shears in frames rotated by any angle, in addition to the drag from closing.
    The first carries two thirds.
    """
    weight = mass * (9.81 + acceleration)
    turned = [(math.cos(a), math.sin(a)) for a in (0.3, 2.0)]
    before = np.array([[0.02, -0.05], [-0.01, 0.04]])
    loads = weight * np.array([2 / 3, 1 / 3])
    now = [
        touch(x + load * direction[0], y + load * direction[1], 1.0)
        for (x, y), load, direction in zip(before, loads, turned, strict=True)
    ]
    found = grasp_estimation.estimate_weight(now, before, acceleration=acceleration)
    assert found.mass == pytest.approx(mass, rel=1e-9)
    np.testing.assert_allclose(found.load, loads)
    np.testing.assert_allclose(found.fraction, [2 / 3, 1 / 3])


def test_the_standard_deviation_of_a_weight_is_that_of_its_errors():
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(2000):
        before = rng.normal(0, NOISE, (2, 2))
        noise = rng.normal(0, NOISE, (2, 2))
        gain = 1 + grasp_estimation.GAIN_SD * rng.standard_normal()
        down = gain * 0.06 * 9.81 / 2
        now = [touch(x, y - down, 1.0) for x, y in noise]
        found = grasp_estimation.estimate_weight(now, before)
        errors.append((found.mass - 0.06) / found.sd)
    assert np.std(errors) == pytest.approx(1.0, abs=0.1)  # sd of 2000: 0.016
    assert 0.0005 < found.sd < 0.0015  # 60 g to 1 g


def test_a_hold_bounds_friction_from_below_and_a_slip_measures_it():
    held = grasp_estimation.estimate_friction([touch(0.3, 0.4, 1.0), touch(0.0, 0.2, 1.0)])
    assert held.minimum == pytest.approx(0.5 - 2 * held.sd[0]) and math.isnan(held.slipped)
    slid = grasp_estimation.estimate_friction(
        [touch(0.3, 0.4, 1.0, "slipping"), touch(0.0, 0.2, 1.0)]
    )
    assert slid.slipped == pytest.approx(0.5) and 0.18 < slid.minimum < 0.2
    empty = grasp_estimation.estimate_friction([touch(0.0, 0.0, 0.01), UNKNOWN])
    assert empty.minimum == 0.0 and np.isnan(empty.used).all()


def test_required_grip_follows_coulombs_law():
    # 100 g on two fingers of friction 0.5: 0.981 N each
    assert grasp_estimation.min_grip_force(0.1, 0.5, 2) == pytest.approx(0.981)
    assert grasp_estimation.min_grip_force(0.1, 0.5, 2, acceleration=-5.0) == pytest.approx(1.481)


def test_the_support_force_distinguishes_hanging_and_standing_objects():
    held = [(0.0, -0.3), (0.0, -0.3)]
    assert grasp_estimation.support_force([touch(0, -0.3, 1.0)] * 2, held) == pytest.approx(
        -0.3
    )  # hangs
    assert grasp_estimation.support_force([touch(0, 0.0, 1.0)] * 2, held) == pytest.approx(
        0.0
    )  # stands
    assert grasp_estimation.support_force([touch(0, 0.2, 1.0)] * 2, held) == pytest.approx(
        0.2
    )  # is pressed down
    assert grasp_estimation.pull_force([touch(0, 0.0, 1.0)] * 2, held) == pytest.approx(0.6)


@pytest.mark.parametrize("turned", [0.0, 0.7, 2.5])
def test_forces_between_the_fingers_are_no_load(turned):
    """Internal forces between the fingers are not a load.

    Two fingers face each other along x, and the gripper is rotated about x by any angle. A world
    force acts on the held object. An internal force of any size drags one finger up and the other
    down, one to the front and the other to the back.
    """
    cos, sin = math.cos(turned), math.sin(turned)
    spin = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
    frames = [  # columns: axes of S in W, as in the shipped gripper
        spin @ np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]),
        spin @ np.array([[0, 0, -1], [-1, 0, 0], [0, 1, 0]]),
    ]

    def touch_at(force, inner):
        estimated = []
        for sign, R_WS, side in zip((1, -1), frames, (0.5, 0.5), strict=True):
            push = np.array([-sign * 1.0, 0, 0])  # the grip
            f_S = R_WS.T @ (push + side * np.asarray(force) + sign * np.asarray(inner))
            estimated.append(touch(f_S[0], f_S[1], -f_S[2]))
        return estimated

    hangs = touch_at([0, 0, -0.3], [0, 0, 0.03])
    down = grasp_estimation.load_direction(hangs)
    leans = touch_at([0.0, 0.2, -0.5], [0, 0.4, 0.9])
    along, across, through = grasp_estimation.load_vector(leans, down)
    assert along == pytest.approx(0.5) and abs(across) == pytest.approx(0.2)
    assert through == pytest.approx(0.0)
    pulled = grasp_estimation.load_vector(touch_at([0.4, 0, -0.3], [0, 0, 0]), down)
    assert abs(pulled[2]) == pytest.approx(0.4) and pulled[0] == pytest.approx(0.3)
    # more than two: downward alone
    three = grasp_estimation.load_vector([hangs[0]] * 3, [down[0]] * 3)
    np.testing.assert_allclose(three, [3 * (0.15 - 0.03), 0, 0], atol=1e-12)


@pytest.mark.parametrize("slips", [0.0, 0.3, 1.0])
def test_the_shear_of_a_slipping_contact_follows_the_grip(slips):
    """The fraction of the shear that follows the grip is right within its sd, which is small enough
    to decide.

    The grip changes by 5 % at 4 Hz for 0.4 s, the load grows meanwhile, and both have 1 mN of
    noise.
    """
    rng = np.random.default_rng(3)
    time = np.arange(12) / 30
    wobble = 0.05 * np.sin(2 * np.pi * 4 * time)
    found = []
    for _ in range(300):
        normal = 0.8 * (1 + wobble) + rng.normal(0, 0.001, 12)
        shear = 0.4 * (1 + slips * wobble + 0.3 * time) + rng.normal(0, 0.001, 12)
        found.append(grasp_estimation.evaluate_slip_test(normal, shear))
    fractions = np.array([one.fraction for one in found])
    # the load's own growth, 11 % in that time, is in the mean that the shear is compared with
    assert fractions.mean() == pytest.approx(slips, rel=0.08, abs=0.02)
    # 0.001 N of 0.4 and 0.8 N, over 5 % / sqrt 2 of twelve: 0.023
    assert fractions.std() == pytest.approx(np.mean([one.sd for one in found]), rel=0.2)
    assert fractions.std() < 0.035


def test_a_grip_that_does_not_change_determines_nothing():
    steady = np.full(12, 0.8) + 1e-4 * np.sin(np.arange(12))
    assert math.isnan(grasp_estimation.evaluate_slip_test(steady, np.full(12, 0.4)).fraction)
    assert math.isnan(grasp_estimation.evaluate_slip_test([0.8, 0.9], [0.4, 0.4]).fraction)
    assert math.isnan(grasp_estimation.evaluate_slip_test([0.8, math.nan] * 6, [0.4] * 12).fraction)


def test_an_unknown_force_gives_an_unknown_weight():
    both = [touch(0, 0, 1.0), UNKNOWN]
    assert np.isnan(grasp_estimation.shear(both)).tolist() == [[False, False], [True, True]]
    assert math.isnan(grasp_estimation.estimate_weight(both, np.zeros((2, 2))).mass)
    assert math.isnan(grasp_estimation.support_force(both, np.zeros((2, 2))))
    assert math.isnan(grasp_estimation.pull_force(both, np.zeros((2, 2))))


@pytest.mark.parametrize("hardness", [0.7, 1.0, 3.0])
def test_a_grip_s_stiffness_is_found_as_it_closes(hardness):
    """dN/dx = hardness * (110 + 260 N), from a first touch of 0.1 N at an opening of 30 mm; one
    image then has 0.1 mm of backlash."""
    spring = grasp_estimation.GripStiffnessEstimator()
    ball = lambda force: math.log1p(260 * force / 110) / 260  # noqa: E731
    for force in np.linspace(0.1, 0.9, 60):
        displacement = (ball(force) - ball(0.1)) / hardness
        spring = grasp_estimation.GripStiffnessEstimator(**asdict(spring)).after(
            0.03 - displacement, force, 1 / 30
        )
    assert spring.stiffness(0.9) == pytest.approx(hardness * (110 + 260 * 0.9), rel=0.02)
    # the same curve between two forces; its slope at the first one is only half of the last one's
    assert spring.way(0.3, 0.9) == pytest.approx((ball(0.9) - ball(0.3)) / hardness, rel=0.02)
    assert spring.way(0.9, 0.3) == -spring.way(0.3, 0.9)
    loose = spring.after(0.03 - displacement - 1e-4, 0.9, 1 / 30)
    assert loose.hardness == pytest.approx(hardness, rel=0.03)
    # a travel as short as the backlash gives no measurement
    assert (
        grasp_estimation.GripStiffnessEstimator()
        .after(0.03, 0.1, 0.03)
        .after(0.0299, 0.12, 0.03)
        .hardness
        == 1.5
    )


def test_the_support_of_the_table_is_no_load():
    hangs = [touch(0, -0.3, 1.0)] * 2
    load = grasp_estimation.LoadEstimator().after(hangs, 1 / 30).hanging(hangs).after(hangs, 1 / 30)
    assert load.mass == pytest.approx(0.6 / 9.81) and load.worst == pytest.approx(0.32)
    pressed = [touch(0, 0.8, 1.0)] * 2
    assert load.after(pressed, 1 / 30).worst < load.worst


def test_a_load_grows_with_the_increase_of_two_images():
    """A load grows with the increase that two images show.

    One image may be wrong. With the second, for a hanging object, the expected further increase
    counts, too: 0.3 N more, less the part that a low-pass of 0.15 s has followed by then. It is not
    kept if the load grows no further.
    """
    hangs = [touch(0, -0.3, 1.0)] * 2
    heavier = [touch(0, -0.6, 1.0)] * 2
    stands = grasp_estimation.LoadEstimator().after(hangs, 1 / 30)
    for load, coming in ((stands, 0.0), (stands.hanging(hangs), 0.3 * (1 - 1 / 4.5))):
        once = load.after(heavier, 1 / 30)
        assert once.worst == pytest.approx(0.32)
        assert once.after(hangs, 1 / 30).worst == pytest.approx(0.32)  # it was none
        grown = once.after(heavier, 1 / 30)
        assert grown.worst == pytest.approx(0.6 + coming + 0.02)
        for _ in range(30):
            grown = grown.after(heavier, 1 / 30)
        assert grown.worst == pytest.approx(0.62, abs=1e-3)
        slides = load.after(heavier, 1 / 30, is_slipping=True)  # a second sign in the same image
        assert slides.worst >= 0.62


def test_an_announced_push_adds_to_the_weight_and_not_to_itself():
    """0.1 N of weight and 0.3 N of push, from any side, on two fingers. While the push acts, the
    measured load includes it."""
    hangs = [touch(0, -0.1, 1.0)] * 2
    pushed = [touch(0.15, -0.1, 1.0), touch(-0.15, -0.1, 1.0)]
    load = grasp_estimation.LoadEstimator().after(hangs, 1 / 30)
    assert load.expected(2, 0.3, 0.0) == pytest.approx(math.hypot(0.12, 0.15))  # standing
    load = load.hanging(hangs).after(hangs, 1 / 30)
    before = load.expected(2, 0.3, 0.0)
    assert before == pytest.approx(math.hypot(0.12, 0.15))
    assert load.expected(2, 0.0, 9.81) == pytest.approx(math.hypot(0.12, 0.12))
    for _ in range(30):
        load = load.after(pushed, 1 / 30)
    assert load.worst == pytest.approx(math.hypot(0.1, 0.15) + 0.02, abs=2e-3)
    assert load.expected(2, 0.3, 0.0) == pytest.approx(load.worst)


def test_a_removed_load_is_kept_for_1_5_seconds():
    """A load that has vanished decays with a time constant of 1.5 s, since half of a shake is
    light."""
    heavy = [touch(0, -0.6, 1.0)] * 2
    light = [touch(0, -0.1, 1.0)] * 2
    load = grasp_estimation.LoadEstimator().after(heavy, 1 / 30)
    for _ in range(30):
        load = load.after(light, 1 / 30)
    assert load.worst == pytest.approx(0.6 * math.exp(-1 / 1.5) + 0.02)


def test_a_sliding_object_keeps_its_weight():
    """A sliding contact carries less than the load."""
    load = grasp_estimation.LoadEstimator()
    for shear in (0.3, 0.3, *[0.1] * 90):
        load = load.after([touch(0, -shear, 1.0)] * 2, 1 / 30, is_slipping=shear < 0.2)
    assert load.maximum == pytest.approx(0.3)


def test_the_weight_is_averaged_over_0_7_seconds():
    hangs = [touch(0, -0.3, 1.0)] * 2
    heavier = [touch(0, -0.6, 1.0)] * 2
    load = grasp_estimation.LoadEstimator().hanging(hangs).after(hangs, 1 / 30)
    change = (1 / 30) / 0.7
    mass = load.after(heavier, 1 / 30).mass
    assert mass == pytest.approx((0.6 + 0.6 * change) / 9.81)


def test_a_lateral_push_loads_the_fingers_by_statics():
    """A lateral push of 0.4 N and 0.3 N downward on each finger load it by 0.5 N.

    Fingers that face each other measure the push on the same side in the world.
    """
    hangs = [touch(0, -0.3, 1.0)] * 2
    pushed = [touch(0.4, -0.3, 1.0), touch(-0.4, -0.3, 1.0)]
    load = grasp_estimation.LoadEstimator().hanging(hangs)
    for _ in range(60):
        load = load.after(pushed, 1 / 30)
    assert load.worst == pytest.approx(0.52, abs=1e-3)  # the increase has ended


def test_opposite_shears_of_the_fingers_are_no_load():
    """Opposite shears of two fingers are not load, before and after lifting, however large.

    A box stands askew. Closing drags one finger to one side and the other to the other, by 0.6 N
    per newton; in both finger frames this is the same side. A load of 0.1 N hangs on each.
    """
    stands = [touch(0.18, 0.0, 0.3)] * 2
    load = grasp_estimation.LoadEstimator().after(stands, 1 / 30)
    assert load.worst == pytest.approx(0.02)
    for press in (0.3, 0.6):
        hangs = [touch(0.6 * press, -0.1, press)] * 2
        held = load.after(hangs, 1 / 30).after(hangs, 1 / 30).hanging(hangs).after(hangs, 1 / 30)
        assert held.mass == pytest.approx(0.2 / 9.81)
        assert held.maximum == pytest.approx(0.1)
    # one finger of a gripper with three has no opposite finger
    three = [touch(0.3, 0.4, 1.0)] * 3
    assert grasp_estimation.external_shear(three) == pytest.approx(grasp_estimation.shear(three))


@pytest.mark.parametrize(
    ("effort", "time", "maximum"),
    [
        (4.0, 0.4, 0.8),  # frames carry 3 of 4 N: the measured force, less a fifth
        (4.0, 0.1, math.inf),  # jaws that are stopped push for a moment
        (2.5, 0.4, math.inf),  # 30 % of 2.5 N are the current's error, gears take as much as 1 N
        (math.nan, 0.4, math.inf),
    ],
)
def test_grip_force_is_limited_when_the_jaws_load_the_frames(effort, time, maximum):
    estimated = [touch(0.0, -0.2, normal) for normal in (0.9, 1.1)]
    frames = grasp_estimation.FrameLoadEstimator()
    for _ in range(round(30 * time)):
        frames = grasp_estimation.FrameLoadEstimator(
            **asdict(frames.after(estimated, effort, 1 / 30))
        )
    if math.isinf(maximum):
        assert frames.maximum > 10.0
        return
    assert frames.maximum == pytest.approx(maximum)
    for _ in range(30):  # a second without data about the frames
        frames = frames.after(estimated, 1.0, 1 / 30)
    assert frames.maximum == pytest.approx(
        maximum * math.exp(0.05), rel=0.01
    )  # it grows by 5 % a second


def test_frames_that_stay_loaded_are_released_once():
    """Jaws that open reduce the measured force. Released again and again, the object would fall.

    A sliding object needs more grip in any case.
    """
    frames = grasp_estimation.FrameLoadEstimator()
    for _ in range(60):
        normal = min(1.0, frames.maximum)
        frames = frames.after([touch(0.0, -0.2, normal)] * 2, 4.0, 1 / 30)
    assert frames.maximum == pytest.approx(0.8)
    sliding = frames.after([touch(0.0, -0.2, 0.8)] * 2, 4.0, 1 / 30, is_slipping=True)
    assert sliding.maximum > 10.0
