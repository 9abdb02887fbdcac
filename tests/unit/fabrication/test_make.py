"""`mjtactile fabricate`: patterns against the stretch, the camera against optics, limits that hold."""

import math
import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest

from mjtactile.calibrate.camera import BoardFinder
from mjtactile.core import analytical_solutions, config_fields, optics
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError
from mjtactile.fabrication import (
    camera_check,
    drawing_pages,
    manufacturability,
    print_templates,
    purchased_parts,
)
from mjtactile.fabrication.build import write
from mjtactile.fabrication.dxf_file import write_dxf
from mjtactile.fabrication.housing_layout import Layout
from mjtactile.fabrication.marker_positions import (
    MembraneState,
    growth,
    simulate,
    simulate_largest_loads,
)
from mjtactile.fabrication.pressure_loads import PressureLoads
from mjtactile.fabrication.purchased_parts import Hardware
from mjtactile.sim.sensor.validity_checks import STRETCHED

SVG = {"svg": "http://www.w3.org/2000/svg"}
DENSE = load_sensor("dense")


@pytest.fixture(scope="module")
def layout():
    return Layout.of(DENSE, Hardware(), "dense")


def bulged(design, height):
    """Return a smooth dome or dent in place of the simulator."""
    x = design.markers.p_SM[:, 0] / (design.frame.length / 2)
    y = design.markers.p_SM[:, 1] / (design.frame.width / 2)
    p = np.column_stack([design.markers.p_SM[:, :2], height * (1 - x**2) * (1 - y**2)])
    return MembraneState(f"{1e3 * height:g} mm", p, np.tile([0.0, 0, 1], (len(p), 1)), 1.1, height)


STATES = [bulged(DENSE, h) for h in (0.0, 0.003, -0.004)]


def with_field(design, field, value):
    """Return `design` with the field of its file, in the file's unit."""
    section, key = field.split(".")
    kind = config_fields.entries(SensorDesign)[section].kind
    attribute, entry = next(
        pair for pair in config_fields.entries(kind).items() if pair[1].key == key
    )
    changed = int(value) if entry.integer else value * entry.unit
    return replace(design, **{section: replace(getattr(design, section), **{attribute: changed})})


# Patterns


def circles(svg, group="markers"):
    """Return centres (n, 2) and radii (n,) of the circles of a group, in the SVG's user units."""
    found = ET.fromstring(svg).findall(f"svg:g[@id='{group}']/svg:circle", SVG)
    numbers = np.array([[float(c.get(key)) for key in ("cx", "cy", "r")] for c in found])
    return numbers[:, :2], numbers[:, 2]


@pytest.mark.parametrize(("markers", "radius"), [("ink", 1.0), ("discs", 1.05)])
def test_the_printed_pattern_stretched_is_the_design(markers, radius):
    layout = Layout.of(DENSE, Hardware(markers=markers), "dense")
    for page in print_templates.marker_pages(layout)[:2]:  # transfer print and stencil
        centres, radii = circles(drawing_pages.write_svg(page))
        angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        edge = centres[:, None] + radii[:, None, None] * np.column_stack(
            [np.cos(angle), np.sin(angle)]
        )
        mounted = edge @ (1.05 * np.eye(2))  # the membrane is stretched equally in both directions
        center = mounted.mean(axis=1)
        away = np.linalg.norm(mounted - center[:, None], axis=2)
        # the file has 5 decimals
        np.testing.assert_allclose(center, 1e3 * DENSE.markers.p_SM[:, :2], atol=2e-5)
        # round; discs were not to be stretched
        np.testing.assert_allclose(away, radius * 1e3 * DENSE.markers.radius, atol=2e-5)
        # the centroid stays at the center
        np.testing.assert_allclose(centres.mean(axis=0), 0, atol=1e-5)


def test_an_svg_is_at_one_to_one(layout):
    single = (
        print_templates.board_page(DENSE),
        print_templates.led_page(layout),
        print_templates.cut_page(layout),
    )
    for sheet in (*print_templates.marker_pages(layout), *single):
        root = ET.fromstring(drawing_pages.write_svg(sheet))
        _, _, width, height = map(float, root.get("viewBox").split())
        assert root.get("width") == f"{width:g}mm" and root.get("height") == f"{height:g}mm"
        bars = [
            np.array([p.split(",") for p in line.get("points").split()], float)
            for line in root.findall("svg:g[@id='scale']/svg:polyline", SVG)
        ]
        longest = sorted((np.ptp(bar, axis=0) for bar in bars), key=max)[-2:]
        assert sorted(map(tuple, longest)) == [(0.0, 100.0), (100.0, 0.0)]
        assert (np.abs(np.concatenate(bars)).max(axis=0) < (width / 2, height / 2)).all()


def dxf_entities(text):
    """Return entities of a DXF as (name, {code: value}), and the header's version."""
    lines = text.splitlines()
    pairs = list(zip(map(int, lines[::2]), lines[1::2], strict=True))
    assert pairs[-1] == (0, "EOF")
    start = pairs.index((2, "ENTITIES"))
    found = []
    for code, value in pairs[start + 1 :]:
        if code == 0:
            found.append((value, {}))
        else:
            found[-1][1][code] = value
    return dict(pairs)[1] if (1, "AC1009") in pairs else None, found


def test_a_dxf_has_the_circles_of_the_svg_with_y_up(layout):
    for page in print_templates.marker_pages(layout)[:2]:
        centers, radii = circles(drawing_pages.write_svg(page))
        _, entities = dxf_entities(write_dxf(page))
        found_circles = np.array(
            [[float(e[c]) for c in (10, 20, 40)] for name, e in entities if name == "CIRCLE"]
        )
        assert len(found_circles) >= len(radii)
        for center, radius in zip(centers, radii, strict=True):
            off = np.abs(found_circles - [center[0], -center[1], radius]).max(axis=1)
            assert off.min() < 2e-5  # the SVG has 5 decimals


@pytest.mark.parametrize("name", ["dense", "ellipse"])
def test_the_outlines_of_a_dxf_are_closed_and_have_their_area(name):
    """Lines and arcs of the gasket, chained, enclose flange, opening and holes."""
    made = Layout.of(load_sensor(name), Hardware(), name)
    page = print_templates.cut_page(made)
    _, entities = dxf_entities(write_dxf(page))
    cut = [(kind, e) for kind, e in entities if e.get(8) == "CUT"]
    found = [math.pi * float(e[40]) ** 2 for kind, e in cut if kind == "CIRCLE"]
    pieces, corners = [], []
    for kind, e in cut:
        if kind == "LINE":
            pieces.append(np.array([[e[10], e[20]], [e[11], e[21]]], float))
        elif kind == "ARC":
            first, last = (math.radians(float(e[c])) for c in (50, 51))
            angle = np.linspace(first, last + 2 * math.pi * (last < first), 200)[:, None]
            center = np.array([e[10], e[20]], float)
            pieces.append(center + float(e[40]) * np.hstack([np.cos(angle), np.sin(angle)]))
        elif kind == "POLYLINE":
            assert e[70] == "1"
            corners.append([])
        elif kind == "VERTEX":
            corners[-1].append([float(e[10]), float(e[20])])
    while pieces:
        loop = pieces.pop()
        while np.linalg.norm(loop[0] - loop[-1]) > 1e-5:
            ends = [(k, flip) for k, p in enumerate(pieces) for flip in (0, -1)
                    if np.linalg.norm(p[flip] - loop[-1]) < 1e-5]  # fmt: skip
            ((k, flip),) = ends
            piece = pieces.pop(k)
            loop = np.concatenate([loop, piece if flip == 0 else piece[::-1]])
        corners.append(loop.tolist())
    for points in corners:
        x, y = np.array(points).T
        found.append(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)
    expected = [shape.contour.area for shape in page.shapes if shape.style == "cut"]
    np.testing.assert_allclose(sorted(found), sorted(expected), rtol=1e-4)


def test_a_pdf_is_at_one_to_one(layout):
    """The PDF has a page of A4, and each filled marker has the printed diameter at the printed
    position."""
    pdf = drawing_pages.write_pdf(print_templates.marker_pages(layout)[:1]).decode("latin-1")
    box = [float(v) * 25.4 / 72 for v in re.search(r"/MediaBox \[ ([^]]*)\]", pdf).group(1).split()]
    assert box == pytest.approx([0, 0, 210, 297], abs=0.01)
    found = []
    for path in re.findall(r"((?:[-\d.]+ [-\d.]+ m\n)(?:(?:[-\d.]+ ){6}c\n){4,}h\n\nf)", pdf):
        # the ends of the curves
        xy = np.array(re.findall(r"([-\d.]+) ([-\d.]+) (?:c|m)\n", path), float) * 25.4 / 72
        found.append([*(xy.max(axis=0) + xy.min(axis=0)) / 2, *np.ptp(xy, axis=0)])
    found = np.array(found)
    assert len(found) == 81
    expected = np.array([[c.x + 105, 148.5 - c.y] for c in print_templates.markers(layout)])
    for centre in expected:
        assert np.linalg.norm(found[:, :2] - centre, axis=1).min() < 2e-3
    np.testing.assert_allclose(found[:, 2:], 2 / 1.05, atol=2e-3)  # mm; the file has 1e-6 inch


def test_opencv_finds_the_printed_board():
    sheet = print_templates.board_page(DENSE)
    board = print_templates.board_of(DENSE)
    scale = 24.0  # pixels a mm
    image = np.full((round(60 * scale), round(70 * scale)), 255, np.uint8)
    for shape in sheet.shapes:
        if shape.group == "board":
            c = shape.contour
            corners = np.array([[c.x - c.hx, c.y - c.hy], [c.x + c.hx, c.y + c.hy]]) * scale + (
                35 * scale,
                30 * scale,
            )
            (u0, v0), (u1, v1) = np.rint(corners).astype(int)
            image[v0:v1, u0:u1] = 0
    finder = BoardFinder(board)
    view = finder.find("print", image)
    assert view is not None and len(view.ids) == (board.columns - 1) * (board.rows - 1)
    on_board = finder.corners(view)[:, :2]
    # 0.5 px of 960
    np.testing.assert_allclose(
        np.ptp(view.uv, axis=0) / scale, 1e3 * np.ptp(on_board, axis=0), rtol=2e-3
    )


# Camera


def test_blur_is_that_of_similar_triangles_behind_a_thin_lens():
    near = 40.3
    far = 47.6
    stop = 2.8
    tools = Hardware()
    f = DENSE.camera.fx * tools.pixel
    focus = 2 * near * far / (near + far)
    image_of = lambda z: f * z / (z - f)  # noqa: E731
    for z in (near, far):  # the cone behind the lens, cut by the plane in which `focus` is sharp
        disc = f / stop * abs(image_of(z) - image_of(focus)) / image_of(z)
        others = 1 / 12 + (0.42 * 0.55e-3 * stop / tools.pixel) ** 2
        expected = math.sqrt(others + (disc / 4 / tools.pixel) ** 2)
        assert camera_check.blur(DENSE, tools, stop, near, far) == pytest.approx(expected, rel=1e-9)


def test_motion_blur_of_a_marker_agrees_with_the_stated_value():
    plan = camera_check.plan_camera(DENSE, Hardware(speed=25.0), STATES, "dense")
    eye = optics.Camera.from_design(DENSE.camera, DENSE.glass)
    nearest = np.array([0.0, 0.0, DENSE.camera.distance - 0.004])
    displacement = optics.project(eye, nearest + [25e-3 * plan.exposure, 0, 0]) - optics.project(
        eye, nearest
    )
    assert displacement[0] == pytest.approx(
        purchased_parts.SMEAR, rel=1e-3
    )  # on the axis, through glass and lens
    assert camera_check.plan_camera(
        DENSE, Hardware(speed=50.0), STATES, "dense"
    ).flux == pytest.approx(2 * plan.flux)
    fast = camera_check.plan_camera(DENSE, Hardware(f_number=4.0), STATES, "dense")
    assert fast.flux == pytest.approx(4 * plan.flux) and (plan.stop, fast.stop) == (2.0, 4.0)


def test_mirror_images_obey_the_law_of_reflection():
    led = DENSE.leds.ring_radius * np.array([math.cos(math.pi / 4), math.sin(math.pi / 4)])
    hit = led / 2  # equal angles: halfway, as lens and LED are in one plane
    eye = optics.Camera.from_design(DENSE.camera)
    observed = optics.pixel_from_normalized(eye, eye.lens.distort(hit / DENSE.glass.distance))
    np.testing.assert_allclose(camera_check.led_mirrors(DENSE)[0], observed, atol=1e-6)


def test_the_longest_focal_length_that_is_named_still_shows_all_markers():
    far_out = replace(DENSE, camera=replace(DENSE.camera, fx=900.0))
    with pytest.raises(InputError, match=r"camera.fx_px: 900 .*-4 mm.*at most") as error:
        camera_check.plan_camera(far_out, Hardware(), STATES, "mine.toml")
    limit = float(str(error.value).split()[-1])
    longest = replace(DENSE, camera=replace(DENSE.camera, fx=limit))
    # four digits of 700 px
    assert 0 <= camera_check.plan_camera(longest, Hardware(), STATES, "mine.toml").margin < 0.2
    u = np.concatenate([camera_check.marker_edges(longest, state)[..., 0] for state in STATES])
    # to the edge of the outermost pixels
    room = min(u.min() + 0.5, longest.camera.width - 0.5 - u.max())
    # the band that an edge is fitted in
    assert room == pytest.approx(2 + 3 * DENSE.camera.blur_px, abs=0.2)


# Limits


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("frame.wall_mm", 0.5),
        ("membrane.pre_stretch", 0.97),
        ("glass.thickness_mm", 0.2),
        ("glass.distance_mm", 21.0),
        ("markers.pitch_x_mm", 2.1),
        ("markers.pitch_y_mm", 3.49),
        ("leds.count", 0),
        ("leds.count", 60),
        ("leds.ring_radius_mm", 8.0),
        ("chamber.depth_mm", 8.0),
        ("chamber.supply_pressure_kPa", 900.0),
    ],
)
def test_an_infeasible_value_is_refused_with_a_feasible_limit(field, value):
    """The error line names the field, its value and the limit; the limit itself is accepted."""
    design = DENSE
    if field == "chamber.depth_mm":  # the chamber ends at the glass
        design = with_field(with_field(design, "glass.distance_mm", 35.0), field, value)
    if field == "chamber.supply_pressure_kPa":
        design = with_field(
            with_field(design, "glass.thickness_mm", 12.0), "glass.distance_mm", 13.0
        )
    bad = with_field(design, field, value)
    with pytest.raises(InputError) as error:
        Layout.of(bad, Hardware(), "mine.toml")
    text = str(error.value)
    assert text.startswith(f"mine.toml: {field}: {value:g} ") and "\n" not in text
    limit = float(re.search(r"at (?:least|most) ([\d.e+-]+)$", text).group(1))
    good = with_field(bad, field, limit)
    for check in manufacturability.limits_of(good, Hardware()):
        if check.field == field:
            check.check("mine.toml")


def test_at_the_limit_the_stencils_webs_have_the_minimum_width():
    with pytest.raises(InputError) as error:
        Layout.of(with_field(DENSE, "markers.pitch_y_mm", 2.2), Hardware(), "mine.toml")
    pitch = float(str(error.value).split()[-1])
    discs = print_templates.markers(
        Layout.of(with_field(DENSE, "markers.pitch_y_mm", pitch), Hardware(), "mine.toml")
    )
    # as printed, unstretched
    assert discs[9].y - discs[0].y - 2 * discs[0].r == pytest.approx(0.3, abs=1e-3)


def test_a_limit_is_rounded_to_an_allowed_value():
    for value, field in ((1.23456, "low"), (98.7654, "high"), (1.23441, "low"), (98.7651, "high")):
        limit = manufacturability.Limit(
            "f", {"low": 1.0, "high": 99.0}[field], "is bad", **{field: value}
        )
        with pytest.raises(InputError) as error:
            limit.check("x")
        named = float(str(error.value).split()[-1])
        assert named != value and named == pytest.approx(value, rel=1e-3)
        replace(limit, value=named).check("x")


@pytest.mark.parametrize(
    ("option", "tools"),
    [("--camera-holes-mm", Hardware(holes=12.0)), ("--pupil-mm", Hardware(pupil=5.0))],
)
def test_options_that_cannot_be_built_are_named(option, tools):
    with pytest.raises(InputError, match=f"^{option}: .*; at least"):
        Layout.of(DENSE, tools, "mine.toml")


def test_infeasible_optics_are_refused():
    sharp = replace(DENSE, camera=replace(DENSE.camera, blur_px=0.2))
    with pytest.raises(InputError, match=r"camera.blur_px: 0.2 is sharper .* at least 0.4"):
        camera_check.plan_camera(sharp, Hardware(), STATES, "mine.toml")
    with pytest.raises(InputError, match=r"^--speed-mm-s: 1000 needs .*at most 33"):
        camera_check.plan_camera(DENSE, Hardware(speed=1000.0), STATES, "mine.toml")
    with pytest.raises(InputError, match=r"leds.count: 4 LEDs would need .* at least 6"):
        camera_check.plan_camera(DENSE, Hardware(speed=300.0), STATES, "mine.toml")
    with pytest.raises(InputError, match=r"^--f-number: 22 gives a blur of"):
        camera_check.plan_camera(DENSE, Hardware(f_number=22.0), STATES, "mine.toml")


def test_the_stress_of_the_glass_agrees_with_timoshenko():
    """A square plate's coefficient is 0.2874 (Timoshenko's 0.0479 x 6), which the formula has
    within 0.1 %."""
    square = replace(DENSE, frame=replace(DENSE.frame, length=0.03, width=0.03))
    assert manufacturability.glass_stress(square, 1e5) == pytest.approx(
        0.2874 * 0.1 * (30 / 2) ** 2, rel=1e-3
    )


def test_simulated_states_are_inflated_and_pressed():
    """One of four positions: flat, inflated as in the closed form, and indented to the requested
    depth."""
    flat, pressed, inflated, both = simulate(
        DENSE, Hardware(), "dense", lambda _: None, {"the middle": (0, 0)}
    )
    assert flat.height == 0 and flat.stretch == DENSE.membrane.pre_stretch
    # the default mesh has 1.4 %
    assert inflated.height == pytest.approx(
        analytical_solutions.bulge_height(DENSE, 1000.0), rel=0.02
    )
    center = pressed.p_SM[40, 2]
    assert center == pytest.approx(-0.004, abs=1e-4) and both.p_SM[40, 2] == pytest.approx(
        inflated.height - 0.004, abs=1e-4
    )


def test_an_indentation_beyond_the_material_law_is_refused_with_a_depth_that_is_not():
    middle = {"the middle": (0, 0)}
    with pytest.raises(InputError, match=r"^--press-mm: 9 stretches .* 1\.4, .*at most") as error:
        simulate(DENSE, Hardware(press=9.0), "mine.toml", lambda _: None, middle)
    limit = float(str(error.value).split()[-1])
    assert 5 < limit < 9
    states = simulate(DENSE, Hardware(press=limit), "mine.toml", lambda _: None, middle)
    assert 1.3 < max(state.stretch for state in states) <= STRETCHED
    soft = replace(DENSE, membrane=replace(DENSE.membrane, young=0.16e6))
    with pytest.raises(InputError, match=r"supply_pressure_kPa: 1.4 stretches .* to 1\.4"):
        simulate(
            with_field(soft, "chamber.supply_pressure_kPa", 1.4), Hardware(), "x", lambda _: None
        )
    stretched = replace(DENSE, membrane=replace(DENSE.membrane, pre_stretch=1.5))
    with pytest.raises(InputError, match=r"membrane.pre_stretch: 1.5 .* at most 1\.4"):
        Layout.of(stretched, Hardware(), "mine.toml")


def test_indentations_at_the_edge_of_a_round_opening_stay_inside():
    # a ball of 7.5 mm over a corner of the box around 30 mm would press on the frame: stretch 1.7
    states = simulate(
        load_sensor("round30"), Hardware(), "round30", lambda _: None, {"a corner": (1, 1)}
    )
    assert max(state.stretch for state in states) < 1.3


def test_pump_and_pressure_sensor_cover_sealed_indentations_and_the_fit_protocol():
    """The sensor covers 2.5 N of the servo; the pump supplies the 3 kPa that `fit` requires."""
    states = simulate(DENSE, Hardware(), "dense", lambda _: None, {"the middle": (0, 0)})
    *protocols, servo = simulate_largest_loads(DENSE)
    assert max(state.gauge_pressure for state in protocols) > 4000
    force = float(re.search(r"with (\S+) N", servo.name).group(1))
    assert 2.5 <= force < 2.9  # a step of half a millimeter
    loads = PressureLoads.of(DENSE, states, [*protocols, servo])
    assert loads.highest is servo and servo.gauge_pressure > 4800
    assert loads.pump == 3000.0
    assert 1e3 * loads.sensor_range >= 1.1 * servo.gauge_pressure
    assert loads.sensor_range in (6.0, 10.0)  # kPa, preferred values
    alone = PressureLoads.of(DENSE, states, [])
    assert alone.pump == 1000.0 and alone.sensor_range == 2.5  # 1.8 kPa at 4 mm


def test_the_mount_tolerance_keeps_a_fifth_of_the_tension():
    tolerance, error = manufacturability.mount_tolerance(DENSE)
    assert error == pytest.approx(0.2 * 0.05)
    # the outermost markers of the shorter direction are 12 mm from the center
    assert tolerance == pytest.approx(12 * error / 1.05)
    more = replace(DENSE, membrane=replace(DENSE.membrane, pre_stretch=1.15))
    assert manufacturability.mount_tolerance(more)[0] > 2 * tolerance
    text = drawing_pages.write_svg(
        print_templates.marker_pages(Layout.of(DENSE, Hardware(), "x"))[2]
    )
    assert f"within {tolerance:.2f} mm" in text


def test_elastic_markers_grow_with_the_membrane():
    """Elastic markers grow by the membrane's uniform stretch; rotation and translation do not
    count."""
    rotation = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])
    stretched = MembraneState(
        "x", 1.03 * DENSE.markers.p_SM @ rotation.T + [0, 0, 0.004], np.zeros((81, 3)), 1.1, 0.0
    )
    assert growth(DENSE, [STATES[0], stretched]) == pytest.approx(0.03)


def test_a_supply_pressure_beyond_the_membrane_limit_is_refused():
    with pytest.raises(
        InputError, match=r"supply_pressure_kPa: 60 exceeds the " r"stability limit.*at most"
    ) as error:
        simulate(
            with_field(DENSE, "chamber.supply_pressure_kPa", 60.0),
            Hardware(),
            "mine.toml",
            lambda _: None,
        )
    assert np.isfinite(
        analytical_solutions.bulge_height(DENSE, 1e3 * float(str(error.value).split()[-1]))
    )


def test_files_are_written_completely_or_not_at_all(tmp_path):
    (tmp_path / "cad").write_text("in the way")
    with pytest.raises(InputError, match="cannot be written"):
        write({"a.md": b"a", "cad/b.stl": b"b"}, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["cad"]
