"""Tests of solids of `mjtactile fabricate`: against closed forms, closed, and of the expected
genus."""

import math
import re
from collections import Counter
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.fabrication import mesh, part_renderings, step_file
from mjtactile.fabrication.housing_layout import Layout
from mjtactile.fabrication.layered_solid import Bore, Contour, Part, circle, crossing, plate
from mjtactile.fabrication.parts import make_parts, mouth, opening
from mjtactile.fabrication.purchased_parts import Hardware

DENSE = load_sensor("dense")
CHORDS = mesh.PER_QUARTER


@pytest.fixture(scope="module")
def layout():
    return Layout.of(DENSE, Hardware(), "dense")


@pytest.fixture(scope="module")
def parts(layout):
    return make_parts(layout)


@pytest.fixture(scope="module")
def solids(parts):
    return {name: mesh.solid_of(part) for name, part in parts.items()}


def polygon_area(c):
    """Compute the area of a contour with arcs replaced by chords."""
    n = CHORDS
    return 4 * c.hx * c.hy - 4 * c.r**2 + 2 * n * c.r**2 * math.sin(math.pi / (2 * n))


def read_stl(data):
    count = int(np.frombuffer(data[80:84], "<u4")[0])
    assert len(data) == 84 + 50 * count
    rows = np.frombuffer(
        data[84:], np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("none", "<u2")])
    )
    return rows["corners"]


def test_stl_files_are_closed_and_have_their_volume(parts, solids):
    for name, part in parts.items():
        corners = read_stl(mesh.write_stl(mesh.triangles_of(solids[name])))
        edges = Counter()
        for a, b, c in (tuple(map(bytes, triangle)) for triangle in corners):
            for edge in ((a, b), (b, c), (c, a)):
                edges[edge] += 1
        assert all(
            count == 1 and edges[end, start] == 1 for (start, end), count in edges.items()
        ), name
        p = corners.astype(float)
        volume = np.einsum("ni,ni->", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6  # divergence theorem
        chords = sum(
            (layer.high - layer.low)
            * (polygon_area(region.outer) - sum(map(polygon_area, region.holes)))
            for layer in part.layers
            for region in layer.regions
        )
        if part.bore:
            chords -= polygon_area(circle(part.bore.radius)) * (
                part.bore.ends[1] - part.bore.ends[0]
            )
        assert volume == pytest.approx(chords, rel=2e-6), name  # single precision
        assert volume == pytest.approx(part.volume, rel=2e-3), name  # the arcs' chords


def step_shell(text):
    """Return edges as (number, forward) by loop, loops by face, and the ends of each edge, of a
    STEP file."""
    lines = dict(re.findall(r"#(\d+)=(.*);", text))
    numbers = {n: re.findall(r"#(\d+)", line) for n, line in lines.items()}

    def kind(name):
        return {n: numbers[n] for n, line in lines.items() if line.startswith(name + "(")}

    oriented = {n: (refs[0], ".T." in lines[n]) for n, refs in kind("ORIENTED_EDGE").items()}
    ends = {n: refs[:2] for n, refs in kind("EDGE_CURVE").items()}
    loops = {n: [oriented[e] for e in refs] for n, refs in kind("EDGE_LOOP").items()}
    faces = [[numbers[b][0] for b in refs[:-1]] for refs in kind("ADVANCED_FACE").values()]
    shells = list(kind("CLOSED_SHELL").values())
    points = {
        n: np.array(re.search(r"\(([-\d.,]+)\)\)$", lines[refs[0]]).group(1).split(","), float)
        for n, refs in kind("VERTEX_POINT").items()
    }
    return ends, loops, faces, shells, points


def check_shell(part, genus):
    """Check that the faces of a STEP file are one closed shell of this genus."""
    ends, loops, faces, shells, points = step_shell(step_file.write_step(part))
    assert len(shells) == 1 and len(shells[0]) == len(faces)
    used = Counter(edge for face in faces for loop in face for edge in loops[loop])
    # each edge once each way: closed, consistent
    assert set(used.values()) == {1} and {e for e, _ in used} == set(ends)
    assert all((edge, not forward) in used for edge, forward in used)
    for loop in loops.values():
        boundary = [ends[e] if forward else ends[e][::-1] for e, forward in loop]
        assert all(one[1] == other[0] for one, other in pairwise([*boundary, boundary[0]]))
    euler = len(points) - len(ends) + len(faces) - (sum(map(len, faces)) - len(faces))
    assert euler == 2 - 2 * genus, part.name  # Euler and Poincare
    assert np.ptp(np.array(list(points.values()))[:, 2]) == pytest.approx(part.size[2])


def test_step_files_are_closed_shells_of_the_right_genus(parts, solids):
    for name, part in parts.items():
        if part.make:
            check_shell(part, solids[name].genus())  # the mesh's


def test_the_bore_is_the_only_opening_of_the_chamber(parts, solids, layout):
    assert solids["frame"].genus() == len(layout.bolts) + 2  # bolts, opening, port
    assert replace(parts["frame"], bore=None).volume - parts["frame"].volume == pytest.approx(
        math.pi * layout.port.radius**2 * (layout.outer_x - layout.open_x)
    )


def test_parts_do_not_intersect_and_intersections_are_detected(parts, solids):
    assert mesh.overlaps(solids) == []
    moved = {"membrane": solids["membrane"], "frame": solids["frame"].translate((0, 0, 1.0))}
    assert [pair[:2] for pair in mesh.overlaps(moved)] == [("membrane", "frame")]


def test_crossing_contours_are_detected():
    body = Contour(10, 8, 2)
    assert crossing(Part("p", (plate(0, 1, body, [circle(1, 5, 0), circle(1, 8, 0)]),))) is None
    # over the edge, over another hole, touching the edge
    for bad in (circle(1, 9.5, 0), circle(1, 5.5, 0), circle(1, 9, 0)):
        assert crossing(Part("p", (plate(0, 1, body, [circle(1, 5, 0), bad]),))) is not None
    # of neighbouring layers
    assert crossing(Part("p", (plate(0, 1, body), plate(1, 2, Contour(8, 8, 2))))) is not None
    assert Bore(Contour(3, 3), body, 1, 0, 0.5).ends == (3, 10)


def test_an_image_shows_each_part(parts, solids):
    image, places = part_renderings.render(
        part_renderings.bodies_of(parts, solids, {"frame": 0.0, "glass": -30.0}), pixels=120
    )
    frame, glass = (image[tuple(np.rint(place[::-1]).astype(int))] for place in places)
    assert places[0][0] < places[1][0]  # the front is on the left
    # the glass is bluish and bright
    assert glass[2] > glass[0] and glass.mean() > frame.mean() > 0.1


def polygon_of(corners, radius=2e-3):
    frame = replace(DENSE.frame, shape="polygon", corners=corners, corner_radius=radius)
    x, y = frame.outline.half_sizes
    return replace(DENSE, frame=replace(frame, length=2 * x, width=2 * y))


HEXAGON = polygon_of([(17e-3 * np.cos(a), 17e-3 * np.sin(a)) for a in np.arange(6) * np.pi / 3])
PENTAGON = polygon_of(
    ((0.018, -0.009), (0.018, 0.011), (-0.004, 0.016), (-0.02, 0.0), (-0.006, -0.015)), 3e-3
)

ROUNDED = replace(DENSE.frame, shape="rounded", corner_radius=4e-3)


@pytest.mark.parametrize(
    "design",
    [
        load_sensor("round30"),
        load_sensor("ellipse"),
        replace(DENSE, frame=ROUNDED),
        HEXAGON,
        PENTAGON,
    ],
    ids=["circle", "ellipse", "rounded", "hexagon", "pentagon"],
)
def test_a_frame_of_another_outline_is_a_solid_around_it(design):
    layout = Layout.of(design, Hardware(), "mine.toml")
    area = 1e6 * design.frame.area
    # a polygon of 240 corners
    assert mouth(layout).area == pytest.approx(area, rel=1e-3)
    # and the flat area of the air inlet; a hexagon has a corner there
    assert area < opening(layout).area < 1.025 * area
    found = make_parts(layout)
    for name in ("frame", "clamp_ring", "membrane", "gasket"):
        solid = mesh.solid_of(found[name])
        # chords of the bolt holes against closed forms
        assert solid.volume() == pytest.approx(found[name].volume, rel=2e-3)
        if found[name].make:
            check_shell(found[name], solid.genus())
    assert mesh.solid_of(found["frame"]).genus() == len(layout.bolts) + 2  # opening, port
    assert cover_of(found["membrane"]) > area


def cover_of(membrane):
    """Return the area of the rubber in front of the rim and the opening, mm^2."""
    return membrane.layers[-1].regions[0].area
