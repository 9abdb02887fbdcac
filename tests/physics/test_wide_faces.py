"""A plate wider than the frame moves nearly all markers alike, as a camera drift does. Its force
must not be attributed to camera drift or gas."""

import numpy as np
import pytest

from mjtactile import load_sensor
from mjtactile.experiments.test_bench import View, take_references
from mjtactile.sim import ground_truth
from mjtactile.sim.attach import default_mesh
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

MESH = {"round30": (25, 25)}  # others: 25 x 21; its plate force is within 1 % of 33 x 28 up to 4 N


def presses_of(sensor, depths, gauges, *, size=0.06, at=(0.0, 0.0), tilt=0.0, unloaded=0):
    """Yield true force, N, and touches of a box with edges of `size` m, pressed in steps after
    `unloaded` images.

    There is one touch for each of `gauges`: with or without a pressure sensor.
    """
    design = load_sensor(sensor)
    mesh = MESH.get(sensor, (25, 21))
    world = PressWorld(design, Indenter("box", size), at=at, tilt=tilt, mesh=mesh)
    views = [View(world, design, gauge=gauge) for gauge in gauges]
    take_references(world, views, design.chamber.supply_gauge)
    for _ in range(unloaded):
        world.step(10)
        for view in views:
            view.touch()
    for depth in depths:
        world.press(depth)
        for view in views:
            view.touch()
        force = -float(ground_truth.contact_force(world, 0)[2])
        yield force, [view.touch() for view in views]


def presses(sensor, depths, *, gauge=True, **how):
    """Yield true force, N, and touch of `presses_of` with or without a pressure sensor."""
    for force, (touch,) in presses_of(sensor, depths, (gauge,), **how):
        yield force, touch


# Gauge pressure times flattened area bounds the force; the area follows from statics. The required
# errors are those of `bench wide-faces`, and 20 mN of noise below 0.5 N.
@pytest.mark.parametrize(
    ("sensor", "gauge", "error"),
    [
        ("paper16", True, 0.03),
        ("dense", True, 0.03),
        pytest.param("fine", True, 0.03, marks=pytest.mark.slow),
        pytest.param("round30", True, 0.04, marks=pytest.mark.slow),
        pytest.param("dense", False, 0.05, marks=pytest.mark.slow),
    ],
)
def test_the_force_of_a_plate_is_not_absorbed(sensor, gauge, error):
    depths = (0.5e-3, 1.0e-3, 1.5e-3, 2.0e-3)
    for force, touch in presses(sensor, depths, gauge=gauge):
        assert touch.status == "ok"
        assert touch.force_normal == pytest.approx(force, rel=error, abs=0.02)
        assert abs(touch.force_normal - force) < 3 * touch.force_normal_sd


# In one step a plate moves the markers so far that a camera change explains them better than compact
# tractions do. Without a start from an unchanged camera, the force was 38 to 87 % too low, "ok".
# The 8 % are the reported standard deviation with 16 markers and without a pressure sensor.
def test_a_sudden_plate_is_no_camera_change():
    for force, touch in presses("paper16", (1e-3, 1.5e-3, 2.0e-3), gauge=False):
        assert touch.status == "ok"
        assert touch.force_normal == pytest.approx(force, rel=0.08)
        assert abs(touch.force_normal - force) < 3 * touch.force_normal_sd


# A camera change that leaves another load in the same image is no explanation: 8.9 N were reported as
# 1.1 +- 0.2 N, "ok". The reported standard deviation is 13 % with 16 markers.
@pytest.mark.slow
def test_a_sudden_plate_after_images_without_a_load_is_no_camera_change():
    ((force, touch),) = presses("paper16", (2.9e-3,), gauge=False, unloaded=3)
    assert force > 8
    assert abs(touch.force_normal - force) < 2 * touch.force_normal_sd
    assert touch.force_normal_sd < 0.25 * force


# Without a pressure sensor and without images before the load, a plane and a changed zoom explained
# the markers: the force was 31 % too low with a standard deviation of 7 %.
@pytest.mark.slow
def test_a_plate_in_the_first_image_does_not_change_the_estimated_zoom():
    for force, touch in presses("round30", (1e-3, 1.5e-3, 2.0e-3), gauge=False):
        assert touch.status == "ok"
        assert touch.force_normal == pytest.approx(force, rel=0.05)
        assert abs(touch.force_normal - force) < 2 * touch.force_normal_sd


# The edges of these cubes lie beyond the outermost markers: no marker shows where the contact ends.
# The force was up to 18 % too low with a standard deviation of 1.3 %.
@pytest.mark.slow(15)
@pytest.mark.parametrize("size", [0.025, 0.03])
def test_the_interval_contains_the_force_of_a_cube_with_edges_inside_the_frame(size):
    depths = (1e-3, 1.5e-3, 2.0e-3, 2.25e-3)
    for force, touches in presses_of("dense", depths, (True, False), size=size):
        for touch, allowed in zip(touches, (0.03, 0.05), strict=True):
            if touch.status == "ok":
                error = abs(touch.force_normal - force)
                assert error < max(2 * touch.force_normal_sd, allowed * force)
                assert touch.force_normal_sd < 0.5 * force
            else:
                assert touch.status.code == "inconsistent"


# Next to the frame, the default mesh has one segment in place of a curve; the force is up to 10 % off.
def test_a_face_that_reaches_the_frame_of_a_coarse_mesh_is_flagged():
    flags = {}
    for name, indenter, mesh in [
        ("plate", Indenter("box", 0.06), None),
        ("ball", Indenter("sphere", 0.03), None),
        ("fine", Indenter("box", 0.06), (25, 21)),
    ]:
        world = PressWorld("dense", indenter, mesh=mesh)
        world.inflate(1e3, seal=True)
        world.press(1e-3)
        assert "sharp_edge" not in world.flags, name
        world.press(1.75e-3)
        flags[name] = str(world.flags.get("sharp_edge", ""))
    assert "use 25 x 21 vertices" in flags["plate"]
    assert not flags["ball"]
    assert not flags["fine"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("size", "at", "tilt"), [(0.035, (-2e-3, 1.5e-3), 0.5), (0.045, (0.0, 2e-3), 1.0)]
)
def test_cubes_off_center_and_tilted(size, at, tilt):
    depths = (0.5e-3, 1.0e-3, 1.75e-3)
    for force, touch in presses("dense", depths, size=size, at=at, tilt=np.radians(tilt)):
        assert touch.status == "ok"
        assert touch.force_normal == pytest.approx(force, rel=0.04, abs=0.02)
        assert abs(touch.force_normal - force) < 3 * touch.force_normal_sd


# A flat membrane carries the gas pressure only, so that the area is force over gauge pressure. Patches
# of compact contacts had 216 mm^2 instead of 545, with an interval up to 389.
@pytest.mark.parametrize("sensor", ["dense", pytest.param("round30", marks=pytest.mark.slow)])
def test_the_area_of_a_plate_follows_from_pressure(sensor):
    design = load_sensor(sensor)
    world = PressWorld(design, Indenter("box", 0.06))
    view = View(world, design, gauge=True)
    take_references(world, [view], design.chamber.supply_gauge)
    world.press(1.5e-3)
    view.touch()
    contact = view.touch().contact
    area = ground_truth.contact_area(world, 0)
    assert contact.area == pytest.approx(area, rel=0.05)
    low, high = contact.area_interval
    assert low < area < high
    assert np.pi * contact.semi_axes.prod() == pytest.approx(area, rel=0.1)


# Below 0.5 N no plane was tested: the force was three standard deviations too low. The mean error of
# light plates on this sensor is 5 %.
@pytest.mark.slow
def test_the_interval_contains_the_force_of_a_light_plate():
    for force, touch in presses("round30", (0.45e-3, 0.65e-3, 0.8e-3), gauge=False):
        assert force < 0.4
        assert touch.force_normal == pytest.approx(force, rel=0.1, abs=0.01)
        assert abs(touch.force_normal - force) < 2.4 * touch.force_normal_sd


# Images of the untouched membrane determine the camera before a light load.
@pytest.mark.slow
def test_images_before_the_load_show_the_camera():
    design = load_sensor("round30")
    world = PressWorld(design, Indenter("box", 0.06))
    view = View(world, design, gauge=False)
    take_references(world, [view], design.chamber.supply_gauge)
    for _ in range(10):
        world.step(10)
        view.touch()
    world.press(0.75e-3)
    view.touch()
    touch = view.touch()
    force = -float(ground_truth.contact_force(world, 0)[2])
    assert 0.25 < force < 0.35
    # the model error of light plates on this sensor is 5 %
    assert touch.force_normal == pytest.approx(force, rel=0.06)
    assert abs(touch.force_normal - force) < 2 * touch.force_normal_sd


# A plate deeper than the frame rests on the frame: no marker shows the fraction of the load on the
# membrane.
@pytest.mark.slow
def test_a_plate_on_the_frame_is_not_ok():
    depths = (0.5e-3, 1.25e-3, 1.75e-3, 2.25e-3)
    *_, (force, touch) = presses("round30", depths)
    assert force > 4
    assert touch.status.code == "inconsistent"
    assert "frame" in touch.status
    assert np.isnan(touch.force_normal) and touch.traction is None  # no value for logs and JSON


# A drift is slow, a load is not: without an image before the load, it was read as a drift, 6.2 N as
# 4.0 +- 0.1 and 1.4 +- 0.7 N, "ok". The mesh of 13 x 11 vertices is 7 % off for `fine`. Images of one
# load differ by their noise, at most 0.5 % (rms).
@pytest.mark.parametrize("gauge", [True, False])
@pytest.mark.parametrize("sensor", ["paper16", "fine"])
def test_a_load_in_the_first_image_is_no_camera_drift(sensor, gauge):
    design = load_sensor(sensor)
    world = PressWorld(design, Indenter("box", 0.06))
    view = View(world, design, gauge=gauge)
    take_references(world, [view], design.chamber.supply_gauge)
    world.press(2.5e-3)
    force = -float(ground_truth.contact_force(world, 0)[2])
    estimated = [view.touch().force_normal for _ in range(4)]
    assert estimated == pytest.approx([force] * 4, rel=0.08)
    assert np.ptp(estimated) < 0.02 * force


# Without a pressure sensor, circle sizes alone give the height of a plane: 0.02 px of `fine` are
# 0.1 mm, a quarter of the force. The default mesh of the simulation is coarse enough for that.
@pytest.mark.slow
def test_a_plane_that_circle_sizes_contradict_is_not_ok():
    design = load_sensor("fine")
    world = PressWorld(design, Indenter("box", 0.06), mesh=default_mesh(design))
    view = View(world, design, seed=3)
    take_references(world, [view], design.chamber.supply_gauge)
    unknown = 0
    for depth in np.arange(0.5e-3, 2.8e-3, 0.25e-3):
        world.press(depth)
        view.touch()
        touch = view.touch()
        force = -float(ground_truth.contact_force(world, 0)[2])
        if touch.status.code == "inconsistent":
            assert "circle sizes contradict" in touch.status
            unknown += 1
        else:  # 5 %, or two standard deviations
            allowed = max(0.05 * force, 2 * touch.force_normal_sd, 0.02)
            assert touch.force_normal == pytest.approx(force, abs=allowed)
    assert 0 < unknown <= 4
