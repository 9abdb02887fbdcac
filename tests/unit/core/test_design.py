"""Tests of sensor files: a file is read exactly, in SI, or rejected with its name, the field and a
valid value."""

import math
import re
import tomllib
from dataclasses import replace

import pytest

from mjtactile.core import config_fields, resources
from mjtactile.core.design import SensorDesign, load_sensor, sensor_from_table
from mjtactile.core.errors import InputError
from mjtactile.core.neo_hookean import Law
from mjtactile.core.sensor_parts import Frame

DENSE = resources.find("dense", "models/sensors", ".toml")


def table(**changes):
    """Return the dense sensor's table with `section__key=value` changed, or removed where the value
    is None."""
    result = tomllib.loads(DENSE.read_text())
    for name, value in changes.items():
        section, _, key = name.partition("__")
        if not key and value is None:
            del result[section]
        elif not key:
            result[section] = value
        elif value is None:
            del result[section][key]
        else:
            result[section][key] = value
    return result


def build(**changes):
    return sensor_from_table(table(**changes), name="test", source="test.toml")


@pytest.mark.parametrize("name", resources.names("models/sensors", ".toml"))
def test_shipped_sensors_load(name):
    design = load_sensor(name)
    assert design.name == name and design.markers.p_SM.shape == (design.markers.count, 3)


def test_values_are_si():
    design = load_sensor("dense")
    assert design.frame.length == pytest.approx(0.040) and design.membrane.young == pytest.approx(
        1e6
    )
    assert design.chamber.supply_gauge == pytest.approx(1000) and design.markers.rows == 9
    # pre-stretch 1.05: T0 = mu h (1 - c / 1.05^2), mu = E / 2.9, where (c - 1) + 4.5 ln(c 1.05^4) =
    # 0: c = 0.8504946
    assert design.membrane.pretension == pytest.approx(
        1e6 / 2.9 * 3e-4 * (1 - 0.8504946 / 1.05**2), rel=1e-5
    )
    # T0 = E h ((1.05^2 - 1)/2) / (1 - nu) = 1e6 x 0.3e-3 x 0.05125 / 0.55
    plain = replace(design.membrane, law=Law.STVK)
    assert plain.pretension == pytest.approx(27.9545, rel=1e-4)
    assert design.apparent_glass_thickness == pytest.approx(0.684e-3, abs=1e-6)  # 2 mm of n = 1.52


def test_markers_are_centred_and_row_by_row():
    p = load_sensor("dense").markers.p_SM
    assert abs(p.mean(axis=0)).max() < 1e-15
    assert p[1, 0] - p[0, 0] == pytest.approx(0.004) and p[9, 1] - p[0, 1] == pytest.approx(0.003)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"membrane__young_MPa": None}, ["membrane.young_MPa", "missing"]),
        ({"membrane": None}, ["[membrane]", "missing section"]),
        ({"membrain": {}}, ["membrain", "did you mean 'membrane'"]),
        ({"membrane__thicknes_mm": 1.0}, ["thicknes_mm", "did you mean 'thickness_mm'"]),
        ({"membrane__thickness_um": 300.0}, ["thickness_um", "wrong unit", "'thickness_mm'"]),
        ({"membrane__thickness_mm": -0.3}, ["membrane.thickness_mm", "-0.3", "0.01 to 5"]),
        ({"membrane__thickness_mm": math.nan}, ["membrane.thickness_mm", "nan"]),
        ({"membrane__thickness_mm": math.inf}, ["membrane.thickness_mm", "inf"]),
        ({"membrane__thickness_mm": "0.3"}, ["membrane.thickness_mm", "not a number"]),
        ({"membrane__thickness_mm": True}, ["membrane.thickness_mm", "not a number"]),
        ({"membrane__poisson_ratio": 0.5}, ["membrane.poisson_ratio", "0.5"]),
        ({"markers__rows": 9.5}, ["markers.rows", "whole number"]),
        ({"camera__distortion": [0.1, 0.2]}, ["camera.distortion", "list of 5"]),
        ({"camera__distortion": [0.1, 0, 0, math.nan, 0]}, ["camera.distortion[3]", "nan"]),
        ({"markers__radius_mm": 2.5}, ["markers.pitch_", "touch"]),
        ({"markers__pitch_x_mm": 6.0}, ["markers.pitch_x_mm", "more than the frame"]),
        ({"chamber__depth_mm": 30.0}, ["camera.distance_mm", "do not fit"]),
        ({"leds__marker_DN": 200.0}, ["leds.marker_DN", "darker"]),
    ],
)
def test_a_wrong_field_is_named(changes, words):
    with pytest.raises(InputError) as caught:
        build(**changes)
    text = str(caught.value)
    assert text.startswith("test.toml: ") and "\n" not in text
    assert [word for word in words if word not in text] == []


def test_every_field_is_checked():
    """No number of the file can be NaN or text without being named."""
    labels = [label for label, *_ in config_fields.scalars(SensorDesign)]
    assert len(labels) == 49
    circles = {
        "surface": "rim",
        "radius_mm": 1.0,
        "positions_mm": [[21.5, 3.0 * k] for k in range(4)],
    }
    for label in (*labels, "camera.distortion"):
        on_glass = {"surface": "glass"} if label == "fiducials.blur_px" else {}
        for bad in (math.nan, "1"):
            sections = {"fiducials": circles | on_glass, "relaxation": {"terms_s": [[0.1, 1.0]]}}
            if label == "frame.corner_radius_mm":
                sections = {"frame__shape": "rounded"}
            changes = sections | {label.replace(".", "__"): bad}
            with pytest.raises(InputError, match=re.escape(label)):
                build(**changes)


@pytest.mark.parametrize("name", resources.names("models/sensors", ".toml"))
def test_written_values_are_read_again(name):
    design = load_sensor(name)
    table = config_fields.write(design)
    assert sensor_from_table(table, name="other", source="other.toml") == design
    round_one = replace(design, frame=Frame(0.07, 0.07, shape="circle"), fiducials=None)
    table = config_fields.write(round_one)
    assert table["frame"] == {"diameter_mm": 70.0, "wall_mm": 3.0, "shape": "circle"}
    assert sensor_from_table(table, name="other", source="other.toml") == round_one


def test_an_optional_section_has_defaults():
    assert build(leds=None).leds.count == 4


def test_missing_and_unknown_files_are_named(tmp_path):
    with pytest.raises(InputError, match=r"dense, dense_fiducials, ellipse, fine, paper16"):
        load_sensor("dence")
    with pytest.raises(InputError, match="no such file"):
        load_sensor(tmp_path / "x.toml")
    (tmp_path / "x.toml").write_bytes(b"\xff\xfe[")
    with pytest.raises(InputError, match=r"x\.toml.*TOML"):
        load_sensor(tmp_path / "x.toml")


def test_more_markers_than_sensing_has_memory_for_are_refused():
    """A valid file with 200 x 200 markers would allocate 12.7 GiB."""
    markers = replace(load_sensor("dense").markers, rows=200, columns=200)
    with pytest.raises(InputError, match=r"markers\.rows: 200 x 200 .* 12\.7 GiB") as caught:
        replace(load_sensor("dense"), markers=markers).require_markers_that_fit()
    assert "\n" not in str(caught.value)
    load_sensor("dense").require_markers_that_fit()


def near_camera(distance_mm, **camera):
    """Return the table of `dense` with a thin chamber and its camera at another distance."""
    table = tomllib.loads(DENSE.read_text())
    table["chamber"]["depth_mm"] = 8.0
    table["glass"]["distance_mm"] = 5.0
    table["camera"] |= {"distance_mm": distance_mm, "distortion": [0.0] * 5} | camera
    return table


def test_markers_outside_the_image_are_named_with_the_distance_that_shows_all():
    """The edge of a marker at y = 13 mm reaches v = 240 px at 13 * 600 / 240 = 32.5 mm; the glass
    brings it closer by 0.7 mm. At 28 mm all but the inner 7 x 7 markers are cut."""
    with pytest.raises(InputError) as caught:
        sensor_from_table(near_camera(28.0), name="near", source="near.toml")
    message = str(caught.value)
    for words in ("near.toml", "camera.distance_mm", "32 of 81 markers", "640 x 480", "[-16, -12]"):
        assert words in message
    distance = float(re.search(r"inside from (\S+) mm", message).group(1))
    assert distance == pytest.approx(33.3, abs=0.3)
    design = sensor_from_table(near_camera(distance), name="far", source="far.toml")
    assert not len(design.markers_outside_image())


def test_markers_behind_the_fold_of_a_lens_are_not_in_the_image():
    """1 + k1 r^2 folds at r^2 = -1 / (3 k1): at r = 0.258 for k1 = -5. With the glass 0.7 mm
    closer, that is 11.4 mm off the center of the membrane, and the edge of a marker is 1 mm farther
    than its center. 31 of the markers at (4 i, 3 j) mm are within 10.4 mm of the center."""
    centers = [math.hypot(4 * i, 3 * j) for i in range(-4, 5) for j in range(-4, 5)]
    behind = sum(r > 10.4 for r in centers)
    with pytest.raises(InputError, match=f"{behind} of 81 markers outside the image"):
        table = near_camera(45.0, distortion=[-5.0, 0.0, 0.0, 0.0, 0.0])
        sensor_from_table(table, name="x", source="x.toml")


def test_a_fisheye_shows_more_markers_at_the_same_distance():
    """At 17.1 mm behind the glass the edge at x = 17 mm is 45 degrees off the axis: 600 tan = 600 px,
    395 atan = 309 px."""
    fisheye = {"distortion_model": "equidistant", "distortion": [0.0] * 4, "fx_px": 395.0}
    sensor_from_table(near_camera(17.8, fy_px=355.0, **fisheye), name="x", source="x.toml")
    with pytest.raises(InputError, match="outside the image"):
        sensor_from_table(near_camera(17.8), name="x", source="x.toml")


def test_no_distance_shows_markers_to_a_camera_that_points_elsewhere():
    with pytest.raises(InputError, match="no larger distance shows all: check fx_px"):
        sensor_from_table(near_camera(40.0, cx_px=2000.0), name="x", source="x.toml")
