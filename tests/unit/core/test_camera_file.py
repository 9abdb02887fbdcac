"""Camera files: of each format the same camera; others are refused by name; none can hang."""

import cv2
import numpy as np
import pytest
import yaml

from mjtactile.core import camera_file
from mjtactile.core.errors import InputError
from mjtactile.core.lens import MODELS
from mjtactile.core.optics import Camera
from tests.lenses import CAMERAS

K = [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]
D = [-0.05, 0.01, 1e-3, 0.0, 0.002]
EXPECTED = Camera(640, 480, 500.0, 510.0, 320.0, 240.0, tuple(D))
BLOCK = "".join(f"- {x}\n" for x in D)
FORMATS = {
    "echo of ROS 2": f"""header:
  stamp: {{sec: 1, nanosec: 2}}
  frame_id: cam
height: 480
width: 640
distortion_model: plumb_bob
d:
{BLOCK}k: {K}
r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
p: [500.0, 0.0, 320.0, 0.0, 0.0, 510.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi: {{x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}}
---
height: 1
""",
    "echo of ROS 1": f"""header: {{seq: 1, frame_id: cam}}
height: 480
width: 640
distortion_model: "plumb_bob"
D: {D}
K: {K}
---
""",
    "yaml of OpenCV": f"""%YAML:1.0
---
calibration_time: "Fri"
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: {K}
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: {D}
""",
    "xml of OpenCV": f"""<?xml version="1.0"?>
<opencv_storage>
<image_Width>640</image_Width>
<image_Height>480</image_Height>
<Camera_Matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
<data>{" ".join(map(str, K))}</data></Camera_Matrix>
<Distortion_Coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt>
<data>{" ".join(map(str, D))}</data></Distortion_Coefficients>
</opencv_storage>
""",
    "ini of ROS": f"""# oST version 5.0 parameters
[image]

width
640

height
480

[cam]

camera matrix
500.0 0.0 320.0
0.0 510.0 240.0
0.0 0.0 1.0

distortion
{" ".join(map(str, D))}

rectification
1 0 0
0 1 0
0 0 1
""",
}
KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [500.0, 510.0, 320.0, 240.0]
  distortion_model: {model}
  distortion_coeffs: {k}
  resolution: [640, 480]
  rostopic: /cam0/image_raw
"""


def read(tmp_path, text):
    file = tmp_path / "camera"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return Camera.from_file(file)


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_has_the_same_camera(tmp_path, name):
    assert read(tmp_path, FORMATS[name]) == EXPECTED


def test_files_that_opencv_writes(tmp_path):
    for suffix in ("yaml", "xml"):
        path = tmp_path / f"camera.{suffix}"
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", 640)
        storage.write("image_height", 480)
        storage.write("camera_matrix", np.reshape(K, (3, 3)))
        storage.write("distortion_coefficients", np.reshape(D, (1, 5)))
        storage.release()
        assert Camera.from_file(path) == EXPECTED


def test_kalibr_files_are_read(tmp_path):
    camera = read(tmp_path, KALIBR.format(model="radtan", k=D[:4]))
    assert camera == Camera(640, 480, 500.0, 510.0, 320.0, 240.0, (*D[:4], 0.0))
    camera = read(tmp_path, KALIBR.format(model="equi", k=D[:4]))
    assert (camera.distortion_model, camera.distortion) == ("equidistant", tuple(D[:4]))


@pytest.mark.parametrize("model", MODELS)
def test_a_written_camera_info_is_read(tmp_path, model):
    camera = CAMERAS[model]
    info = camera_file.camera_info((camera.width, camera.height), camera.K, camera.lens, "left")
    assert read(tmp_path, yaml.safe_dump(info)) == camera


@pytest.mark.parametrize(
    ("k", "more", "model"),
    [
        ([0.1, 0.2, 0.0, 0.0, 0.3, 0.4, 0.5, 0.6], "", "rational_polynomial"),
        ([0.1, 0.2, 0.0, 0.0, 0.3] + [0.0] * 9, "", "plumb_bob"),
        ([0.0] * 4, "", "plumb_bob"),
        ([0.1, 0.2, 0.3, 0.4], "fisheye_model: 1\n", "equidistant"),
    ],
)
def test_without_a_name_the_coefficients_of_opencv_determine_the_model(tmp_path, k, more, model):
    camera = read(
        tmp_path, f"width: 640\nheight: 480\ncamera_matrix: {K}\ndist_coeffs: {k}\n{more}"
    )
    assert camera.distortion_model == model
    assert camera.distortion == tuple(k[: len(camera.distortion)]) + (0.0,) * (
        len(camera.distortion) - len(k)
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("# Camera list\n1 OPENCV 640 480 500 500 320 240 0 0 0 0\n", ["COLMAP", "k1, k2, p1, p2"]),
        ("%YAML:1.0\nmodel_type: KANNALA_BRANDT\n", ["camodocal", "equidistant"]),
        ("Camera.fx: 500.0\nCamera.fy: 500.0\n", ["ORB-SLAM", "camera_info"]),
        ('{\n  "value0": {"intrinsics": []}}', ["Basalt", "camera_info"]),
        ("<calibration><projection>frame</projection></calibration>", ["Metashape", "OpenCV"]),
        (b"MATLAB 5.0 MAT-file\x00\xff", ["MATLAB", "cameraIntrinsicsToOpenCV"]),
        (b"\x00\x01\x02", ["not valid YAML", "#x0000"]),
        (b"\x1f\x8b\x08\x00", ["archive", "ost.yaml"]),
        (
            KALIBR.replace("pinhole", "omni").format(model="radtan", k=D[:4]),
            ["omni", "pinhole-equi"],
        ),
        ((KALIBR + KALIBR.replace("cam0:", "cam1:")).format(model="equi", k=D[:4]), ["2 cameras"]),
        (
            f"width: 640\nheight: 480\nk: {K}\nd: [0.1, 0.2, 0.3, 0.4]\n",
            ["fisheye", "distortion_model", "equidistant"],
        ),
        (f"width: 640\nheight: 480\nk: {K}\nd: {[0.1] * 12}\n", ["thin prism", "k6"]),
        (f"width: 640\nheight: 480\nbinning_x: 2\nk: {K}\nd: {D}\n", ["binning_x", "scale"]),
        ("<a/>", ["<a>", "opencv_storage"]),
        ("just text", ["not a camera file", "Kalibr"]),
    ],
)
def test_other_formats_are_refused_with_the_conversion(tmp_path, text, words):
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    assert all(word in message for word in words), message
    assert "\n" not in message and str(tmp_path) in message


NESTED = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 60))
ENTITIES = "<!DOCTYPE z [<!ENTITY a 'x'>]><opencv_storage>&a;</opencv_storage>"


@pytest.mark.parametrize(
    "text",
    [
        NESTED,
        "[" * 100_000,
        "{a: " * 25_000,
        "- " * 50_000,
        "<a>" * 40_000,
        "<opencv_storage>" + "<a>" * 30_000,
        ENTITIES,
        "width: " + "9" * 100_000,
        "width: 2024-99-99",
        "? " * 60_000,
        "#" * 200_000,
        "\n" * 120_000,
        "\t" * 120_000,
        "1 " + "A" * 120_000,
        "<!--" * 30_000,
        "<a>" + "<!--" * 30_000,
        "a " * 60_000,
        "'" + "\n" * 100_000,
        "a: 1\n" * 20_000,
        "{" + "a," * 60_000,
        "[image]\n" + "1 " * 60_000,
        "[image]\n" * 15_000,
        b"\xff" * 1000,
        "",
    ],
    ids=lambda text: repr(text[:20]),
)
def test_a_file_cannot_block_the_reader(tmp_path, text):
    """Sizes double with each alias; brackets recurse. The pytest limit of time is the measure."""
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    assert len(str(caught.value)) < 1000 + len(str(tmp_path))


YAML = """image_width: 640
image_height: 480
camera_name: finger
camera_matrix:
  rows: 3
  cols: 3
  data: [600.0, 0.0, 319.5, 0.0, 601.0, 239.5, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.05, 0.01, 1e-5, 0.0, 0.0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
"""


def test_ros_camera_info(tmp_path):
    file = tmp_path / "camera.yaml"
    file.write_text(YAML)
    camera = Camera.from_file(file)
    assert (camera.width, camera.height, camera.fy, camera.cx) == (640, 480, 601.0, 319.5)
    assert camera.distortion == (-0.05, 0.01, 1e-5, 0.0, 0.0)


def test_camera_file_with_glass(tmp_path):
    file = tmp_path / "camera.yaml"
    file.write_text(YAML + "glass: {thickness_mm: 5, refractive_index: 1.5, distance_mm: 120}\n")
    camera = Camera.from_file(file)
    assert (camera.glass_thickness, camera.glass_index, camera.glass_distance) == pytest.approx(
        (5e-3, 1.5, 0.12)
    )


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("image_width: 640", "image_width: 640\nglass: 5", "glass"),
        (
            "image_width: 640",
            "image_width: 640\nglass: {thickness_mm: 5, refractive_index: 1.5}",
            "distance_mm",
        ),
        (
            "image_width: 640",
            "image_width: 640\nglass: {thickness_mm: 5, refractive_index: 0.5, distance_mm: 1}",
            "glass.refractive_index",
        ),
        ("image_width: 640", "image_width: -3", "image_width"),
        ("image_width: 640", "img_width: 640", "image_width"),
        ("plumb_bob", "omnidirectional", "distortion_model"),
        ("plumb_bob", "equidistant", "distortion_coefficients"),
        ("data: [600.0, 0.0,", "data: [600.0, 0.1,", "camera_matrix.data"),
        ("data: [600.0,", "data: [", "camera_matrix.data"),
        ("[-0.05", "[.nan", "distortion_coefficients.data[0]"),
        ("[-0.05", "[left", "distortion_coefficients.data[0]"),
        ("image_width: 640", "image_width: [640", "YAML"),
    ],
)
def test_bad_camera_info_names_file_and_field(tmp_path, old, new, field):
    file = tmp_path / "camera.yaml"
    file.write_text(YAML.replace(old, new))
    with pytest.raises(InputError) as caught:
        Camera.from_file(file)
    assert str(file) in str(caught.value)
    assert field in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_camera_info_is_one_line():
    with pytest.raises(InputError, match="nowhere"):
        Camera.from_file("nowhere.yaml")
