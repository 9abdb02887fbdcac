"""Tests of the parts that `make` builds for fiducials: a groove behind the rim's lip, and their
print."""

import re
from dataclasses import replace

import pytest

from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.fabrication import manual, mesh
from mjtactile.fabrication.drawing_pages import write_svg
from mjtactile.fabrication.housing_layout import Layout
from mjtactile.fabrication.parts import make_parts
from mjtactile.fabrication.print_templates import fiducial_page
from mjtactile.fabrication.purchased_parts import Hardware

DESIGN = load_sensor("dense_fiducials")


def layout_of(design):
    return Layout.of(design, Hardware(), "x.toml")


def test_the_groove_of_the_frame_equals_that_of_the_gas_volume():
    """The frame has the groove that the gas model includes.

    Compared with the same frame without it, the volume is smaller by the groove's volume. The frame
    is one solid as before, and the remaining wall has the minimum printed thickness.
    """
    plain = make_parts(layout_of(replace(DESIGN, fiducials=None)))["frame"]
    frame = make_parts(layout_of(DESIGN))["frame"]
    groove = 1e9 * DESIGN.fiducials.volume(DESIGN)
    assert plain.volume - frame.volume == pytest.approx(groove, rel=1e-9)
    solid = mesh.solid_of(frame)
    assert solid.volume() == pytest.approx(frame.volume, rel=2e-3)
    assert len(solid.decompose()) == 1


def test_the_print_has_each_circle_at_its_position():
    svg = write_svg(fiducial_page(layout_of(DESIGN)))
    circles = re.findall(r'<circle cx="([-\d.]+)" cy="([-\d.]+)" r="([\d.]+)"', svg)
    found = [(float(x), float(y)) for x, y, r in circles if float(r) == 0.8]
    # to 1e-5 mm, as the file is written
    requested = [(round(1e3 * x, 5), round(1e3 * y, 5)) for x, y in DESIGN.fiducials.places]
    assert sorted(found) == sorted(requested)


def test_a_sensor_without_fiducials_has_no_fiducial_step_or_page():
    plain = layout_of(replace(DESIGN, fiducials=None))
    assert fiducial_page(plain) is None
    assert manual.steps_of(plain) == manual.STEPS
    titles = [step.title for step in manual.steps_of(layout_of(DESIGN))]
    assert titles.index("Fixed reference circles") < titles.index("Glue it to the rim")


def test_a_wall_that_would_be_too_thin_is_refused():
    thin = replace(DESIGN, frame=replace(DESIGN.frame, rim=4.0e-3))
    with pytest.raises(
        InputError, match=r"fiducials\.wall_setback_mm: 3\.2 leaves too thin a wall"
    ):
        layout_of(thin)
