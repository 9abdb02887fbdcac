"""Tests of the texts and requests of the windows: the same code as in Studio, with stand-in
widgets."""

import math
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from mujoco.studio.dear_imgui import dear_imgui
from mujoco.studio.implot import implot

from mjtactile.core.design import load_sensor
from mjtactile.core.flags import Flag
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Ellipses
from mjtactile.studio import control_window, layout, panel, plots, scene_overlays, surface_colormap
from mjtactile.studio.control_window import ControlWindow, toggled
from mjtactile.studio.panel import Panel, flagged_text
from mjtactile.studio.session_bridge import SessionBridge
from mjtactile.studio.snapshot import FingerSnapshot, Pose
from tests.fake_run import fake_cycle, fake_image, fake_touch
from tests.unit.studio.fake_gui import FakeGui, FakePlot, FakeViewer


@pytest.fixture
def gui(monkeypatch):
    gui = FakeGui(dear_imgui)
    for module in (panel, control_window, plots, layout):
        monkeypatch.setattr(module, "imgui", gui)
    gui.plot = FakePlot(implot)
    monkeypatch.setattr(plots, "implot", gui.plot)
    return gui


class FakeValve:
    def __init__(self):
        self.asked = []

    def state(self):
        return SimpleNamespace(is_open=True, gauge_pressure=None)

    def open(self, gauge):
        self.asked.append(gauge)

    def close(self):
        self.asked.append("closed")


@pytest.fixture
def bridge():
    """Provide a bridge of a stand-in for a simulated session after 40 cycles."""
    fingers = [
        SimpleNamespace(name=name, design=load_sensor("dense"), valve=None)
        for name in ("left", "right")
    ]
    holes = []
    sensors = [
        SimpleNamespace(
            gauge_pressure=1000.0, temperature=294.0, puncture=lambda c, k=k: holes.append((k, c))
        )
        for k in range(2)
    ]
    scene = SimpleNamespace(sensors=sensors, data=SimpleNamespace(xfrc_applied=np.zeros((3, 6))))
    rig = SimpleNamespace(
        scene=scene,
        host_timeout=math.inf,
        fingers=fingers,
        valves=(FakeValve(), FakeValve()),
        limits=SimpleNamespace(opening=(0.0, 0.12), lift=(0.0, 0.15)),
    )
    rest = SimpleNamespace(
        state=SimpleNamespace(reference=SimpleNamespace(surface=fake_touch(0.0, 0.0).surface))
    )
    bridge = SessionBridge(Scenario(seed=4))
    bridge.fastest = np.inf
    flags = {"sharp_edge": Flag("an edge presses", 0.1, 0.4, 0.2)}
    bridge.start(SimpleNamespace(rig=rig, perceptions=[rest, rest], holes=holes, flags=flags))
    for i in range(40):
        bridge.on_images()
        bridge.add(fake_cycle(i), force_normal_true=[0.1, 0.2])
    return bridge


def build(plugin, cycle=None):
    plugin.viewer = FakeViewer() if plugin._viewer is None else plugin.viewer
    if isinstance(plugin, Panel):
        plugin.on_update(None)
    plugin.on_build_gui(None)


def test_the_panels_numbers_are_the_sessions(gui, bridge):
    build(Panel(bridge))
    for estimated in bridge.snapshot().fingers:
        touch = estimated.touch
        shear = np.hypot(*touch.traction.wrench[:2])
        for text in (
            f"normal {touch.force_normal:+.3f} N, 2 sd {2 * touch.force_normal_sd:.3f}",
            f"shear  {shear:.3f} N",
            f"ground truth {estimated.true:+.3f} N",
            f"area   {1e6 * touch.contact.area:.0f} mm2",
            "20.9 C",
        ):
            assert any(text in line for line in gui.texts), text
    assert "gas    closed, 1.00 kPa" in " ".join(gui.texts)
    assert "warning (sharp_edge): an edge presses" in gui.texts
    assert "0.10 to 0.40 s, 20 % of the time" in gui.texts
    time, force = gui.plot.geoms["left, estimated"]
    assert (
        time[-1] == bridge.snapshot().time
        and force[-1] == bridge.snapshot().fingers[0].touch.force_normal
    )
    np.testing.assert_allclose(gui.plot.geoms["right, ground truth"][1], 0.2)
    np.testing.assert_allclose(gui.plot.geoms["left, estimated, bars"][1], 0.06)  # 2 sd
    np.testing.assert_allclose(gui.plot.geoms["left"][1][0], 1.0)  # kPa


def test_the_panel_shows_camera_and_membrane_of_each_finger(gui, bridge):
    plugin = Panel(bridge)
    build(plugin)
    assert len(plugin.viewer.images) == 4 and all(
        image.std() > 5 for image in plugin.viewer.images.values()
    )


def test_the_indentation_is_rest_minus_estimated_shape_and_brightest_where_deepest():
    touch = fake_touch(0.6, 0.0)
    rest = fake_touch(0.0, 0.0).surface
    field = surface_colormap.field_of(
        FingerSnapshot("left", fake_image(0), touch, rest=rest), "indentation"
    )
    assert field.values.max() == pytest.approx(0.6 * 0.002)  # at the center, as in fake_touch
    render = surface_colormap.render(
        FingerSnapshot("left", fake_image(0), replace(touch, traction=None), rest=rest),
        field,
        0.0012,
        (80, 60),
    )
    luminance = render[:, :, 1].astype(int)  # green grows along viridis
    assert luminance[2, 2] < luminance[30, 30] < luminance[30, 40]


def test_integral_and_centroid_of_tractions_are_force_and_center_of_pressure():
    touch = fake_touch(0.6, 0.0)
    field = surface_colormap.field_of(FingerSnapshot("left", fake_image(0), touch), "traction")
    dx = np.diff(field.x)[0]
    dy = np.diff(field.y)[0]
    wx = np.r_[0.5, np.ones(len(field.x) - 2), 0.5] * dx
    wy = np.r_[0.5, np.ones(len(field.y) - 2), 0.5] * dy
    assert wy @ field.values @ wx == pytest.approx(0.6)
    np.testing.assert_allclose(
        surface_colormap.centre_of_pressure(touch), 0, atol=1e-12
    )  # symmetric


def test_the_membrane_in_the_scene_is_the_estimated_surface():
    touch = fake_touch(0.6, 0.0)
    estimated = FingerSnapshot("left", fake_image(0), touch, rest=fake_touch(0.0, 0.0).surface)
    corners, rgb = surface_colormap.surface_geom(
        estimated, surface_colormap.field_of(estimated, "indentation"), 0.0012
    )
    s = touch.surface
    a, b, c = corners.swapaxes(0, 1)
    area = np.cross(b - a, c - a)[:, 2] / 2  # viewed along z
    assert area.sum() == pytest.approx((s.x[-1] - s.x[0]) * (s.y[-1] - s.y[0])) and (area > 0).all()
    center = np.linalg.norm(corners.mean(axis=1)[:, :2], axis=1).argmin()
    assert rgb[center, 1] == rgb[:, 1].max()  # green grows along viridis
    pressed, _ = surface_colormap.surface_geom(
        estimated, surface_colormap.field_of(estimated, "indentation"), 0.0012, minimum=0.04
    )
    assert 0 < len(pressed) < len(corners)
    quiet = replace(estimated, touch=fake_touch(0.0, 0.0))  # nowhere is anything pushed in
    assert [
        len(part)
        for part in surface_colormap.surface_geom(
            quiet, surface_colormap.field_of(quiet, "indentation"), 1e-3, minimum=0.04
        )
    ] == [0, 0]


def test_only_geoms_of_the_touch_are_shown(gui, bridge):
    plugin = Panel(bridge)
    plugin.viewer = FakeViewer()
    stranger = mujoco.MjvGeom()
    plugin.viewer.extra_geoms.append(stranger)
    for _ in range(3):
        build(plugin)
        bridge.add(fake_cycle(40))
    kinds = [int(geom.type) for geom in plugin.viewer.extra_geoms]
    assert plugin.viewer.extra_geoms[0] is stranger
    # two cells of 12 x 10 a finger
    assert kinds.count(int(mujoco.mjtGeom.mjGEOM_TRIANGLE)) == 2 * 240
    assert kinds.count(int(mujoco.mjtGeom.mjGEOM_ARROW)) == 2
    gui.set_input("membranes", "none")
    gui.set_input("net force", False)
    gui.set_input("outlines, centre of pressure", False)
    gui.set_input("camera images", True)
    build(plugin)
    build(plugin)
    assert [int(geom.type) for geom in plugin.viewer.extra_geoms[1:]] == 2 * 8 * [
        int(mujoco.mjtGeom.mjGEOM_LINE)
    ]


def test_a_triangle_and_an_arrow_have_the_given_pose():
    brush = scene_overlays.GeomPool()
    corners = np.array([[1.0, 2, 3], [2, 2, 3], [1, 4, 5]])
    for _ in range(2):  # the second time with the same geoms
        brush.start()
        brush.triangles(corners[None], np.array([[1.0, 0.5, 0.0]]))
    [geom] = brush.geoms
    unit = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])  # MuJoCo's triangle
    np.testing.assert_allclose(geom.pos + unit @ np.asarray(geom.mat).T, corners, atol=1e-6)
    estimated = FingerSnapshot(
        "left", fake_image(0), fake_touch(0.6, 0.0), pose=Pose(np.zeros(3), np.eye(3))
    )
    scene_overlays.update(
        brush, [estimated], scene_overlays.OverlayOptions(surface="none", contacts=False)
    )
    [arrow] = brush.geoms
    along = np.asarray(arrow.mat)[:, 2]
    # the finger pushes the object away, along its own z
    np.testing.assert_allclose(along, [0, 0, 1], atol=1e-6)


def test_reasons_of_rejected_ellipses_are_reported():
    ellipses = Ellipses(
        np.zeros((4, 2)),
        np.ones((4, 2)),
        np.zeros(4),
        np.zeros((4, 5, 5)),
        ["ok", "blurred", "cut", "blurred"],
    )
    assert flagged_text(ellipses) == "3 of 4 rejected: blurred (2), cut"
    assert flagged_text(None) == ""


def test_exception_of_a_handler_is_shown_and_the_next_handler_runs(gui, bridge, monkeypatch):
    plugin = Panel(bridge)
    monkeypatch.setattr(scene_overlays, "update", lambda *_, **__: 1 / 0)
    build(plugin)
    assert any(
        text.startswith("ZeroDivisionError: division by zero (test_panel.py, line")
        for text in gui.texts
    )
    assert any(text.startswith("normal") for text in gui.texts)


def test_the_control_window_sends_requests_to_the_session(gui, bridge):
    plugin = ControlWindow(bridge)
    session = bridge.session

    def do(label, value=True):
        gui.set_input(label, value)
        build(plugin)
        bridge.on_images()

    do("supply, kPa", 0.5)  # the valves are open: it counts at once
    do("close valves")
    assert [valve.asked for valve in session.rig.valves] == 2 * [[500.0, "closed"]]
    do("puncture right", True)
    do("puncture right", False)
    assert [k for k, _ in session.holes] == [1, 1] and session.holes[1][1] == 0.0 < session.holes[
        0
    ][1]
    do("override the controller", True)
    assert bridge.manual_goal.opening == bridge.snapshot().session.opening
    do("opening, mm", 40.0)
    do("lift, mm", 20.0)
    assert (bridge.manual_goal.opening, bridge.manual_goal.lift_height) == (
        0.04,
        0.02,
    ) and math.isnan(bridge.manual_goal.force)
    do("regulate the force", True)
    do("force, N", 1.5)
    assert bridge.manual_goal.force == 1.5
    do("override the controller", False)
    assert bridge.manual_goal is None
    gui.set_input("pause")
    build(plugin)
    assert bridge.paused
    gui.set_input("resume")
    build(plugin)
    assert not bridge.paused


def test_another_run_can_change_object_and_effects(gui, bridge):
    plugin = ControlWindow(bridge)
    for label, value in (
        ("object", "vial"),
        ("accuracy", "0.05N"),
        ("seed", 7),
        ("shadows###shadows", True),
    ):
        gui.set_input(label, value)
        build(plugin)
    assert not bridge.restart.is_set()
    gui.set_input("start")
    build(plugin)
    assert bridge.restart.is_set()
    assert (bridge.scenario.object, bridge.scenario.accuracy, bridge.scenario.seed) == (
        "vial",
        "0.05N",
        7,
    )
    assert bridge.scenario.effects in ("+shadows", "-shadows")  # whichever it was not


def test_a_failed_removal_is_reported(gui, bridge):
    gui.set_input("large deflection", False)
    plugin = ControlWindow(bridge)
    build(plugin)
    assert "cannot be left out" in bridge.last_message and plugin._next.effects == "auto"


def test_an_effect_is_forced_and_released_again():
    assert toggled("auto", "bending", True) == "+bending"
    assert toggled("+bending,-gas", "bending", False) == "-gas"
    assert toggled("-gas", "gas", True) == "auto"
