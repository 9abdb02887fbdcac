"""Tests of contact shapes from the markers of an independent solver's membrane
(benchmarks/membrane_reference.json), with a camera's noise."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import benchmarks.quasistatic
from mjtactile import QuasistaticMembrane, SensingPipeline, load_sensor
from mjtactile.core.types import ContactShape, Markers, RelativeMotion, Slip, Touch
from mjtactile.experiments.test_bench import View, take_references
from mjtactile.quasistatic import obstacle
from mjtactile.quasistatic.obstacles import rows_and_pool
from mjtactile.sensing.apply_contact_shape import attach_shape
from mjtactile.sensing.contact_shape import press_tracker as following
from mjtactile.sensing.contact_shape.estimator import Found
from mjtactile.sensing.contact_shape.force_fusion import _model, below_frame, contact_load
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.relative_motion import MembraneMotion, rubber_step
from mjtactile.sensing.contact_shape.shape_models import FAMILIES
from mjtactile.sensing.settings import DEFAULTS
from mjtactile.sensing.touch.slip import SlipHistory, SlipSample
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

NOISE = np.array([3.4e-6, 3.4e-6, 19e-6])  # marker noise of one `dense` image, m


@pytest.fixture(scope="module")
def sensor():
    """Pipeline of `dense` with the rest shape of the quasi-static membrane (2 um from that of the
    independent sheet), and the shape estimator."""
    design = load_sensor("dense")
    pipeline = SensingPipeline(design)
    solver = QuasistaticMembrane(design, (41, 31))
    rest = seen(in_order(benchmarks.quasistatic._markers(solver, solver.rest)))
    state = pipeline.load_rest_reference(pipeline.initial_state(), rest, solver.gauge_pressure)
    return pipeline, state, pipeline.make_shape_estimator(state)


def shape_of(sensor, *touches):
    pipeline, state, finder = sensor
    return pipeline.estimate_contact_shape(state, touches, finder)


@pytest.fixture(scope="module")
def cases():
    path = Path(benchmarks.quasistatic.__file__).with_name("membrane_reference.json")
    return [case for case in json.loads(path.read_text())["cases"] if "markers_um" in case]


def seen(places, rng=None):
    n = len(places)
    noise = 0.0 if rng is None else NOISE * rng.standard_normal((n, 3))
    cov = np.tile(np.diag(NOISE**2), (n, 1, 1))
    return Markers(np.arange(n), places + noise, np.tile([0.0, 0, 1], (n, 1)), cov)


def touch_of(sensor, places, seed=0) -> Touch:
    pipeline, state, _ = sensor
    markers = seen(places, np.random.default_rng(seed))
    return pipeline.estimate_touch(state, markers, pipeline.fitter.fit(markers), 0.0)[0]


def in_order(places):
    """A reference's markers (81, 3) m in the order of the sensor's."""
    grid = benchmarks.quasistatic._MARKERS
    nominal = load_sensor("dense").markers.p_SM
    return places[[int(np.abs(grid - at[:2]).sum(axis=1).argmin()) for at in nominal]]


def layout_places(case):
    return in_order(1e-6 * np.array(case["markers_um"]))


@pytest.mark.parametrize(
    ("radius_mm", "at_mm"),
    [(8.0, [0.0, 0.0]), pytest.param(30.0, [7.0, -4.0], marks=pytest.mark.slow)],
)
def test_a_ball_is_a_ball_of_its_radius(sensor, cases, radius_mm, at_mm):
    case = next(c for c in cases if c["size_mm"] == [radius_mm] and c["at_mm"] == at_mm)
    touch = touch_of(sensor, layout_places(case))
    assert touch.contact.area_source == "nodal"
    shape = shape_of(sensor, touch)
    assert shape.kind == "smooth" and shape.status == "ok"
    assert sum(shape.probabilities.values()) == pytest.approx(1.0)
    # one image determines it to 3 %; the reference touches the ball with its mid-surface, the
    # membrane with its face, 0.15 mm further in
    assert 1e3 * shape.radius == pytest.approx(radius_mm - 0.15, rel=0.08)
    assert 1e3 * shape.p_SO[:2] == pytest.approx(at_mm, abs=0.2)
    low, high = shape.area_interval
    assert 0 < low < shape.area < high
    # both are frictionless, and the membrane is within 2 %; `friction` of 3 % is added for sticking
    # contact
    assert shape.force_normal == pytest.approx(1.03 * case["force_N"], rel=0.04)
    assert pickle.loads(pickle.dumps(shape)).kind == "smooth"
    touch = attach_shape(touch, shape)
    assert touch.contact.area == shape.area and touch.contact.area_source == shape.family


@pytest.mark.parametrize(
    ("radius_mm", "depth_mm"), [(3.2, 2.4), (4.5, 1.8), (6.8, 1.2), (6.8, 2.4)]
)
def test_a_flat_face_with_a_rim_has_its_own_area(sensor, radius_mm, depth_mm):
    """A sharp rim, small and large, pressed lightly and firmly, on a membrane with 0.5 mm between
    nodes."""
    solver = QuasistaticMembrane(load_sensor("dense"), (81, 61))
    radius = 1e-3 * radius_mm
    height = solver.rest.heights.max() - 1e-3 * depth_mm
    cylinder = solver.obstacle("cylinder", (radius, 0.02), (1e-3, -0.5e-3, 0.02 + height))
    places = in_order(benchmarks.quasistatic._markers(solver, solver.solve(cylinder)))
    shape = shape_of(sensor, touch_of(sensor, places))
    assert shape.kind == "flat" and shape.family == "disc"
    # markers are 3 and 4 mm apart: half a millimetre of a rim's place
    assert shape.radius == pytest.approx(radius, rel=0.12)
    # 0.3 mm of rim, by which a simulated sheet's vertices meet a face within its rim
    assert shape.area == pytest.approx(np.pi * radius**2, rel=0.6e-3 / radius)


def test_without_contact_no_shape_is_reported(sensor):
    pipeline, state, _ = sensor
    still = touch_of(sensor, pipeline.inverse.positions(state.reference.rest.c))
    shape = shape_of(sensor, still)
    assert shape.kind == "unknown" and shape.status != "ok"
    assert attach_shape(still, shape).contact.area_source == "nodal"
    assert np.isnan(shape.area) and np.isnan(shape.radius)
    assert all(np.isnan(p) for p in shape.probabilities.values())


def test_gas_that_came_since_raises_the_markers(sensor):
    """The response to a share of gas against the sheet's own, solved with that much more."""
    pipeline, state, finder = sensor
    rest = state.reference.rest
    fraction = 2e-3
    gas = type(rest.gas)(rest.gas.gauge_pressure, (1 + fraction) * rest.gas.constant)
    more = pipeline.inverse.membrane.equilibrium(gas, rest.stiffness_scale, start=rest.c)
    rise = (pipeline.inverse.positions(more) - pipeline.inverse.positions(rest.c))[:, 2]
    # the sheet's splines are 3 mm wide, and the response is linear to a per cent of it
    assert finder.forward.by_gas * fraction == pytest.approx(rise, rel=0.05, abs=0.05 * rise.max())


@pytest.mark.slow(5)
def test_a_ball_that_shear_pulls_aside_is_one(sensor):
    """A simulated membrane and a ball of 16 mm diameter, whose height is given as a size. It sticks
    and is moved by 0.5 mm. Without shear in the model, the ball is a disc of 3.5 mm, 1.1 mm away."""
    world = PressWorld("dense", Indenter("sphere", 16e-3), at=(1e-3, -0.5e-3), mesh=(33, 25))
    view = View(world, load_sensor("dense"), seed=3)
    take_references(world, [view], world.design.chamber.supply_gauge)
    for depth in (0.8e-3, 1.4e-3, 2e-3):
        world.press(depth)
    world.press(2e-3, 0.5e-3)
    shape = view.perception.shape(view.touch())
    # shear is the larger part of the friction limit; one image determines the radius to 7 %
    assert np.hypot(*ground_truth.contact_wrench(world, 0)[:2]) > 0.25
    assert shape.kind == "smooth" and shape.misfit < 1
    assert shape.radius == pytest.approx(16e-3, rel=0.1)
    # the ball rolls by less than the width of a cell, 1.25 mm
    assert 1e3 * shape.p_SO[:2] == pytest.approx([1.5, -0.5], abs=0.15)


def follow(sensor, touches, rubber=None):
    """Each image's findings, in the order of a press."""
    pipeline, state, finder = sensor
    rest = state.reference.rest
    p_rest = pipeline.inverse.positions(rest.c) + rest.offset
    found, press = [], None
    for touch in touches:
        found.append(finder.follow(touch, press, p_rest, rubber))
        press = found[-1].press
    return found


def pressed(sensor, solver, bodies, seed, time=0.0):
    """Return the touch of a membrane on the obstacles `bodies`."""
    places = in_order(benchmarks.quasistatic._markers(solver, solver.solve(bodies)))
    return replace(touch_of(sensor, places, seed), time=time)


@pytest.fixture(scope="module")
def fine_membrane():
    """Nodes 0.5 mm apart."""
    return QuasistaticMembrane(load_sensor("dense"), (81, 61))


def test_a_press_is_followed_for_some_solutions_an_image(sensor, fine_membrane, monkeypatch):
    """A contact episode takes a few membrane solutions per image.

    At constant depth this is one or two. The first image, with the likely shape models, takes about
    ten.
    """
    radius = 8e-3
    touches = [
        pressed(
            sensor,
            fine_membrane,
            fine_membrane.obstacle("sphere", (radius,), (0, 0, z + radius)),
            n,
        )
        for n, z in enumerate((1.4e-3, 1.3e-3, 1.3e-3, 1.3e-3, 1.3e-3))
    ]
    counts = []
    solve = ForwardModel.solve

    def counted(self, *arguments):
        counts[-1] += 1
        return solve(self, *arguments)

    monkeypatch.setattr(ForwardModel, "solve", counted)
    pipeline, state, finder = sensor
    p_rest = pipeline.inverse.positions(state.reference.rest.c) + state.reference.rest.offset
    press = None
    for touch in touches:
        counts.append(0)
        before, found = press, finder.follow(touch, press, p_rest)
        press = found.press
    assert 4 < counts[0] < 30
    # an object deviates from its model as it did when all models were evaluated
    assert press.images > 0 and press.other is before.other is not None
    # one or two for the steps, and at most one with new slopes
    assert max(counts[2:]) <= 3
    assert found.shape.kind == "smooth"
    assert found.shape.radius_sd < 0.15 * radius
    assert found.shape.radius == pytest.approx(radius, abs=3 * found.shape.radius_sd)


def test_two_balls_at_once_are_two_balls(sensor, fine_membrane, monkeypatch):
    # the network is certain that these are several contacts: no model of one is fitted
    monkeypatch.setattr(following, "suggested", None)
    radii, x = (4.5e-3, 6e-3), (-6.5e-3, 6.5e-3)
    bodies = [
        fine_membrane.obstacle("sphere", (r,), (at, 1e-3, r + 1.2e-3))
        for r, at in zip(radii, x, strict=True)
    ]
    touch = pressed(sensor, fine_membrane, bodies, 3)
    assert len(touch.patches) == 2
    found = follow(sensor, [touch])[0]
    shape = found.shape
    assert shape.kind == "multiple" and len(shape.parts) == 2
    by_place = sorted(shape.parts, key=lambda part: part.p_SO[0])
    for part, radius, at in zip(by_place, radii, x, strict=True):
        # 0.2 N on each, with markers 4 mm apart and few next to the frame
        assert part.radius == pytest.approx(radius, rel=0.3)
        assert part.p_SO[:2] == pytest.approx([at, 1e-3], abs=0.3e-3)
    assert shape.area == pytest.approx(sum(part.area for part in shape.parts))
    estimated = attach_shape(touch, shape, found.load)
    assert {patch.area_source for patch in estimated.patches} <= {
        "ball",
        "cylinder",
        "disc",
        "block",
    }
    assert estimated.contact.area == shape.area


def test_the_force_includes_the_load_on_the_body(sensor, cases):
    """Independent sheets."""
    off, chi2 = [], []
    for case in cases[2::3]:
        touch = touch_of(sensor, layout_places(case))
        found = follow(sensor, [touch])[0]
        estimated = attach_shape(touch, found.shape, found.load)
        # a sticking contact carries 3 % more than a sliding one, and the load includes this
        true = 1.03 * case["force_N"]
        off.append(estimated.force_normal - true)
        chi2.append((off[-1] / estimated.force_normal_sd) ** 2)
        assert estimated.force_normal == pytest.approx(-estimated.traction.wrench[2], abs=5e-3)
        assert np.linalg.eigvalsh(estimated.traction.wrench_cov).min() > 0
    # from single images; their markers also allow a ball between them that is twice as large
    assert max(np.abs(off)) < 0.015
    assert np.mean(chi2) < 2.5  # of four: beyond it once in twenty-five


def test_a_sharp_shape_that_a_body_explains_is_no_warning(sensor, cases):
    """The uncertainty from sharpness vanishes where a shape explains it.

    The shape does not determine the shear: its variance is the remainder of the nodal one's.
    """
    touch = touch_of(sensor, layout_places(cases[2]))
    found = follow(sensor, [touch])[0]
    before = touch.traction.wrench_cov
    sharpness = 0.5 * np.diag(before)

    def estimated(misfit):
        left = (max(misfit, 1.0) / DEFAULTS.contact_shape.misfit_max) ** 2
        load = replace(found.load, explained=1 - left)
        return attach_shape(touch, found.shape, load, sharpness).traction.wrench_cov

    # a ball is not sharp: it cannot explain markers that show sharpness
    assert found.shape.probabilities["smooth"] > 0.9
    assert found.load.explained == pytest.approx(0.0, abs=0.1)
    # normal force and tilt determine none of the shear, to a hundredth
    assert estimated(1.0)[0, 0] / before[0, 0] == pytest.approx(1 - 0.5 * (1 - 1 / 144), abs=0.01)
    assert estimated(12.0)[0, 0] / before[0, 0] == pytest.approx(1.0, abs=0.01)


def test_shear_above_the_pressure_is_no_load_on_a_body(sensor, cases):
    """Shear that acts above the pressure is not part of the load on a shape.

    By statics, shear at a height adds a torque of that height times it, more on sharp shapes.
    """
    touch = touch_of(sensor, layout_places(cases[2]))
    membranes = sensor[2].forward
    press = follow(sensor, [touch])[0].press
    state = press.now.state
    weights = state.contact_forces / state.contact_forces.sum()
    s = DEFAULTS.contact_shape
    height = float((weights * state.heights).sum()) + s.shear_above[0]
    force = np.array([0.05, -0.03, 0.0])
    shear = np.concatenate([force, np.cross([2e-3, -1e-3, height], force)])

    def taken(s):
        """Return the part of the load's components due to shear at the height of blunt shapes."""
        return contact_load(membranes, press, touch.traction.wrench, 2.0, s).rows @ shear

    # of a ball: edge and tip are a thousandth
    assert press.kinds(("smooth", "edge", "point", "flat", "multiple"))["smooth"] > 0.99
    assert taken(s) == pytest.approx(0.0, abs=1e-6 * 0.05)
    lower = replace(s, shear_above=(0.0, 0.0))
    by_height = s.shear_above[0] * np.array([0.0, force[1], -force[0]])
    assert taken(s) - taken(lower) == pytest.approx(by_height, abs=1e-6 * 0.05)


def test_an_object_beside_the_frame_that_presses_below_it_is_uncertain(sensor):
    """Only there: not in the middle of the sensor, nor where a body stays above the frame."""
    membranes = sensor[2].forward
    frame = membranes.membrane.design.frame
    half = frame.length / 2 - 1.5e-3
    radius = 12e-3
    across = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # along x, not z

    def below(*body):
        rows, pool = rows_and_pool([obstacle(*body)], membranes.membrane.grid)
        state = membranes.solve((rows[None], pool))
        return below_frame(membranes, state), state.force_normal

    ball, _ = below("sphere", (radius,), (0, 0, radius - 3e-4))
    high, _ = below("cylinder", (radius, half), (0, 0, radius + 3e-4), across)
    low, force = below("cylinder", (radius, half), (0, 0, radius - 1.5e-4), across)
    assert ball == high == 0.0
    # of its ends, with two rows of nodes each of some 28
    assert 0.01 * force < low < 4 / 28 * force
    load = np.array([-force, 0, 0])
    s = DEFAULTS.contact_shape
    known, near_edge = (_model(load, 1.0, 0.0, 1e-4, at, s)[0, 0] for at in (0.0, low))
    assert near_edge - known == pytest.approx((s.frame_fraction * low) ** 2)


def test_a_ball_that_is_dragged_over_still_rubber_rolls_or_slides(sensor, fine_membrane):
    """A ball that moves over stationary rubber rolls or slides, by its full travel.

    The membrane slides under the ball.
    """
    radius, speed, period = 8e-3, 15e-3, 1 / 30
    touches = [
        pressed(
            sensor,
            fine_membrane,
            fine_membrane.obstacle("sphere", (radius,), (speed * period * n, 0, 1.3e-3 + radius)),
            n,
            time=n * period,
        )
        for n in range(7)
    ]
    still = MembraneMotion(np.zeros(2), 0.0)
    motion = follow(sensor, touches, still)[-1].shape.motion
    sd = np.sqrt(np.diag(motion.velocity_cov))
    assert (sd < 0.3 * speed).all()
    # three of its sd, and a tenth: places of a moving contact err alike between nodes
    assert motion.velocity[0] == pytest.approx(speed, abs=3 * sd[0] + 0.1 * speed)
    assert motion.velocity[1] == pytest.approx(0.0, abs=3 * sd[1] + 0.1 * speed)
    # a ball that goes along x without sliding turns about y
    assert motion.rolling[1] == pytest.approx(motion.velocity[0] / radius, rel=0.15)
    assert np.isnan(motion.spinning)


class KnownMotion:
    """Shape estimator that reports a given motion."""

    def __init__(self, motion):
        self.shape = ContactShape("unknown", {}, motion=motion)

    def follow(self, touch, press, p_rest, rubber):
        return Found(self.shape, None, None)


def test_the_pipeline_detects_a_body_that_turns_on_the_spot(sensor):
    """A shape that turns on the spot makes the chain report slip.

    Its center of pressure is constant: only the shape's motion shows the slip.
    """
    pipeline, state, _ = sensor
    sample = SlipSample(0.0, np.zeros(2), np.zeros(3), np.array([0.5, 0.0, 0.0]))
    before = replace(state, slip=SlipHistory((sample,), np.ones(1), np.zeros((1, 3)), 0.0, 0.9))
    touch = Touch(0.0, 0.0, 1.0, 0.1, True, slip=Slip("sticking", np.zeros(2), 0.0, 0.5))
    zero, none = np.zeros(2), np.zeros((2, 2))
    for spinning, reported in ((0.0, "sticking"), (1.0, "slipping")):
        motion = RelativeMotion(zero, none, zero, none, zero, spinning, 0.05)
        estimated, after = pipeline.track_contact_shape(before, before, touch, KnownMotion(motion))
        assert estimated.slip.state == reported
        assert after.slip.distance == estimated.slip.distance


def test_rubber_that_turns_and_goes_is_distinguished():
    """A rigid motion of the nodes, any weights."""
    rng = np.random.default_rng(1)
    weight = rng.random(30)
    weight /= weight.sum()
    before = rng.normal(size=(30, 3)) * 5e-3
    angle, step = 0.02, np.array([3e-4, -2e-4, 0.0])
    center = weight @ before
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    after = (before - center) @ R.T + center + step
    rubber = rubber_step((weight, weight), (before, after))
    assert rubber.step == pytest.approx(step[:2], abs=1e-9)
    assert rubber.twist == pytest.approx(angle, rel=1e-3)  # 2 tan(angle / 2)


def test_a_press_checks_again_for_families_that_were_close_alone(sensor, cases):
    """A contact episode tries dropped shape models again only if they were close.

    A model that was behind by more than the tenth power of e when it was dropped is not tried.
    """
    touch = touch_of(sensor, layout_places(cases[2]))
    press = follow(sensor, [touch])[0].press
    best = press.candidates[0]
    lost = [replace(best, family=FAMILIES[name]) for name in ("disc", "block")]
    left = tuple(replace(one, behind=by) for one, by in zip(lost, (5.0, 25.0), strict=True))
    near = replace(press, candidates=(best,), dropped=left).near(tuple(FAMILIES.values()))
    assert {family.name for family in near} == {best.family.name, "disc"}


def test_a_followed_fit_that_is_stuck_is_checked_before_all_families(sensor, cases, monkeypatch):
    """A fit that ends far off the markers, from where a look finds the ball again."""
    touch = touch_of(sensor, layout_places(cases[2]))
    alone = follow(sensor, [touch, touch])[1]
    goes_on, asked = following._refit_best, []

    def stuck(membranes, press, hint, data):
        found = goes_on(membranes, press, hint, data)
        off = replace(found.now.at, residual=10 * found.now.at.residual)
        return replace(found, now=replace(found.now, at=off))

    def counted(*given):
        asked.append(given)
        return searched(*given)

    searched = following._search_all
    monkeypatch.setattr(following, "_refit_best", stuck)
    monkeypatch.setattr(following, "_search_all", counted)
    found = follow(sensor, [touch, touch])[1]
    assert len(asked) == 1  # of the first image
    # the same image: as well explained, within the look's own last step
    assert found.shape.misfit < 1.1 * alone.shape.misfit
    assert found.shape.kind == alone.shape.kind


@pytest.mark.parametrize(("searched", "kind"), [(1.1, "unknown"), (2.0, "multiple")])
def test_a_slow_load_searches_by_its_growth_since_the_last_search(
    sensor, fine_membrane, searched, kind
):
    """A ball that becomes two balls. The last evaluation was at a tenth less force. Only a force of
    1.4 times that of the last search shows another shape; else the misfit stays."""
    bodies = [
        fine_membrane.obstacle("sphere", (r,), (at, 1e-3, r + 1.2e-3))
        for r, at in ((4.5e-3, -6.5e-3), (6e-3, 6.5e-3))
    ]
    touch = pressed(sensor, fine_membrane, bodies, 3)
    pipeline, state, finder = sensor
    rest = state.reference.rest
    p_rest = pipeline.inverse.positions(rest.c) + rest.offset
    one = pressed(sensor, fine_membrane, bodies[:1], 3)
    press = finder.follow(one, None, p_rest).press
    force = touch.force_normal
    press = replace(press, force=force / 1.1, search_force=force / searched)
    assert finder.follow(touch, press, p_rest).shape.kind == kind


def test_a_hold_is_followed_without_evaluations(sensor, cases):
    """All models are evaluated after 15 images, but not while force and position are constant: they
    would add no evidence."""
    touch = touch_of(sensor, layout_places(cases[2]))
    pipeline, state, finder = sensor
    rest = state.reference.rest
    p_rest = pipeline.inverse.positions(rest.c) + rest.offset
    press = finder.follow(touch, None, p_rest).press
    due = replace(press, images=DEFAULTS.contact_shape.check_images)
    assert finder.follow(touch, due, p_rest).press.images == due.images + 1
    reported = replace(press.reported, position=press.reported.position + [1e-3, 0])
    moved = replace(due, reported=reported)
    assert finder.follow(touch, moved, p_rest).press.images == 0
