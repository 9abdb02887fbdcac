"""Tests of fiducials in a sensor file: positions, costs, and rejected values."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core import resources
from mjtactile.core.calibration_parts import fingerprint
from mjtactile.core.config_fields import from_table, write
from mjtactile.core.design import load_sensor, sensor_from_table
from mjtactile.core.errors import InputError
from mjtactile.core.fiducials import Fiducials

PANE = {
    "surface": "glass",
    "radius_mm": 0.6,
    "quiet_zone_mm": 0.35,
    "positions_mm": [[-12.0, -6.0], [-12.0, 6.0], [12.0, -6.0], [12.0, 6.0]],
}


def table(**changes):
    """Return the shipped sensor's file with other fiducials."""
    found = tomllib.loads(
        resources.find("dense_fiducials", "models/sensors", ".toml").read_text("utf-8")
    )
    found["fiducials"] = {**found["fiducials"], **changes}
    return found


def read(fiducials):
    return sensor_from_table({**table(), "fiducials": fiducials}, name="x", source="x.toml")


def test_straight_walls_hide_the_rim():
    """The groove behind the lip keeps the circles in view of the camera.

    The line of sight to the innermost point of a circle passes the opening's edge behind the lip.
    The groove is as deep as the line to the outermost point requires.
    """
    design = load_sensor("dense_fiducials")
    fiducials = design.fiducials
    p_SF = fiducials.p_SF(design)
    assert p_SF.shape == (10, 3)
    assert p_SF[:, 2] == pytest.approx(-1e-3)
    outside = np.abs(p_SF[:, 0]).max() + fiducials.radius + fiducials.ground
    depth = fiducials.groove(design)
    # on the line from the camera to the outermost point, at the groove's back
    fraction = 1 - depth / (design.camera.distance - fiducials.lip)
    assert fraction * outside == pytest.approx(design.frame.length / 2)


def test_the_groove_is_part_of_the_gas_volume():
    design = load_sensor("dense_fiducials")
    fiducials = design.fiducials
    without = replace(design, fiducials=None)
    assert without.chamber_volume_flat == pytest.approx(24e-6)
    around = (46.4 * 36.4 - (4 - np.pi) * 3.2**2 - 40 * 30) * 1e-6
    more = design.chamber_volume_flat - without.chamber_volume_flat
    assert more == pytest.approx(around * fiducials.groove(design))


def test_on_the_glass_there_is_no_groove():
    design = read(PANE)
    assert design.fiducials.groove(design) == 0
    assert design.chamber_volume_flat == pytest.approx(24e-6)
    assert design.fiducials.p_SF(design)[:, 2] == pytest.approx(-20e-3, abs=1e-5)


def test_written_values_are_read_again():
    fiducials = load_sensor("dense_fiducials").fiducials
    assert from_table(Fiducials, write(fiducials), "x.toml") == fiducials


def test_a_sensor_without_fiducials_keeps_its_fingerprint():
    """Calibrations from before there were fiducials hold."""
    assert fingerprint(load_sensor("dense")).startswith("19218ca0f031eb56")
    assert fingerprint(load_sensor("dense_fiducials")) != fingerprint(
        replace(load_sensor("dense_fiducials"), fiducials=None)
    )


@pytest.mark.parametrize(
    ("changes", "field", "words"),
    [
        ({"surface": "wall"}, "fiducials.surface", "rim, glass"),
        ({"radius_mm": -1}, "fiducials.radius_mm", "-1"),
        ({"positions_mm": [[1, 2, 3]]}, "fiducials.positions_mm", "pairs"),
        (
            {"positions_mm": [[21.5, 0.0]]},
            "fiducials.positions_mm",
            "has 1 circles; 4 to 64 are allowed",
        ),
        (
            {"positions_mm": [[21.5, 0], [21.5, 2], [21.5, 6], [-21.5, 0]]},
            "fiducials.positions_mm",
            "2 mm apart",
        ),
        (
            {"positions_mm": [[20.5, 0], [21.5, 6], [21.5, -6], [-21.5, 0]]},
            "fiducials.positions_mm",
            "[20.5, 0] is not on the lip",
        ),
        (
            {"positions_mm": [[22.5, 0], [21.5, 6], [21.5, -6], [-21.5, 0]]},
            "fiducials.positions_mm",
            "[22.5, 0] is not on the lip",
        ),
        (
            {"positions_mm": [[0, 16.5], [21.5, 6], [21.5, -6], [-21.5, 0]]},
            "fiducials.positions_mm",
            "[0, 16.5] is outside the image",
        ),
        ({"wall_setback_mm": 4.0}, "fiducials.wall_setback_mm", "no wall at frame.wall_mm = 4.4"),
        ({"lip_mm": 20.0}, "fiducials.lip_mm", "20 is not less than the chamber depth"),
        ({"blur_px": 2.0}, "fiducials.blur_px", "blur_px"),
    ],
)
def test_invisible_fiducials_are_refused_in_one_line(changes, field, words):
    with pytest.raises(InputError) as error:
        sensor_from_table(table(**changes), name="x", source="x.toml")
    text = str(error.value)
    assert "\n" not in text.strip()
    assert "x.toml" in text
    assert field in text
    assert words in text


def test_fiducials_on_the_glass_must_not_hide_the_membrane():
    with pytest.raises(InputError, match="hides part of the membrane"):
        read({**PANE, "positions_mm": [[-10.0, 0.0], *PANE["positions_mm"]]})
