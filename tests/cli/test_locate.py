"""Tests of `mjtactile detect-circles` on images of another renderer: circles are found at their
positions."""

import functools
import json
import math

import cv2
import numpy as np
import pytest

FX = 600.0
WIDTH = 640
HEIGHT = 480
RADIUS_MM = 6.0
DEPTH_MM = 120.0
CAMERA = f"""\
image_width: {WIDTH}
image_height: {HEIGHT}
camera_name: test
camera_matrix: {{rows: 3, cols: 3, data: [{FX}, 0.0, 319.5, 0.0, {FX}, 239.5, 0.0, 0.0, 1.0]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [0.0, 0.0, 0.0, 0.0, 0.0]}}
"""
CENTERS_PX = [(u, v) for v in (120.25, 240.5, 360.75) for u in (140.5, 320.25, 500.0)]


@functools.cache
def render(dark=True):
    """Render frontoparallel circles, supersampled 8 times, then blurred: radius 30 px at 120 mm."""
    scale = 8
    radius = FX * RADIUS_MM / DEPTH_MM
    v, u = np.ogrid[0 : HEIGHT * scale, 0 : WIDTH * scale]
    # pixel (0, 0) is the centre of the top-left pixel
    u = (u + 0.5) / scale - 0.5
    v = (v + 0.5) / scale - 0.5
    # the circles are on a grid
    cu, cv = ((np.unique([c[i] for c in CENTERS_PX])) for i in (0, 1))
    inside = (
        np.abs(u[..., None] - cu).min(-1) ** 2 + np.abs(v[..., None] - cv).min(-1) ** 2 < radius**2
    )
    image = cv2.resize(
        np.where(inside, 40, 190).astype(np.float32), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA
    )
    image = cv2.GaussianBlur(image, (0, 0), 0.7) + np.random.default_rng(0).normal(
        0, 2, (HEIGHT, WIDTH)
    )
    image = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return image if dark else 255 - image


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "camera.yaml").write_text(CAMERA)
    cv2.imwrite(str(tmp_path / "dark.png"), render())
    return tmp_path


def locate(command, source, *args):
    process = command(
        "detect-circles",
        source,
        "--camera",
        "camera.yaml",
        "--radius-mm",
        RADIUS_MM,
        "--json",
        *args,
    )
    assert process.returncode == 0, process.stderr
    return json.loads(process.stdout)["frames"]


def check(frame):
    """Check depth to 0.1 mm: the bound is about 0.01 mm there, one pixel of radius is 4 mm."""
    markers = sorted(frame["markers"], key=lambda m: (round(m["uv_px"][1] / 60), m["uv_px"][0]))
    assert [m["status"] for m in markers] == ["ok"] * 9
    for marker, (u, v) in zip(markers, CENTERS_PX, strict=True):
        assert math.dist(marker["uv_px"], (u, v)) < 0.1
        expected = [(u - 319.5) * DEPTH_MM / FX, (v - 239.5) * DEPTH_MM / FX, DEPTH_MM]
        assert math.dist(marker["center_mm"], expected) < 0.1
        assert marker["normal"][2] < -0.98  # faces the camera
        assert np.all(np.linalg.eigvalsh(marker["cov_center_mm2"]) > 0)
        assert len(marker["normal_alt"]) == 3 and 0.5 <= marker["preferred_probability"] <= 1
        # Eq. V4: the centres are 2 r (r/Z) sin(psi) apart, psi (against the ray) up to 22 degrees
        # in the corners
        assert (
            math.dist(marker["center_alt_mm"], marker["center_mm"])
            < 2 * RADIUS_MM**2 / DEPTH_MM * 0.4
        )
        assert np.all(np.linalg.eigvalsh(marker["cov_center_alt_mm2"]) > 0)
        assert marker["ellipse_px"]["semi_axes"][0] == pytest.approx(30, abs=0.1)


def test_an_image(command, folder):
    (frame,) = locate(command, "dark.png")
    assert frame["source"] == "dark.png"
    assert all(
        set(r) == {"center_px", "semi_axes_px", "status"} and r["status"] != "ok"
        for r in frame["rejected"]
    )
    check(frame)


def test_bright_markers_and_16_bit(command, folder):
    cv2.imwrite(str(folder / "bright.png"), render(dark=False).astype(np.uint16) * 200)
    (frame,) = locate(command, "bright.png", "--bright", "--gamma", "auto")
    check(frame)
    assert frame["gamma"]["assumed"] == 1 and not frame["gamma"]["wrong"]


def test_a_folder_in_name_order_with_a_corrupt_file_and_overlays(command, folder):
    (folder / "images").mkdir()
    cv2.imwrite(str(folder / "images" / "b.png"), render())
    (folder / "images" / "a.png").write_bytes(b"no image")
    cv2.imwrite(str(folder / "images" / "c.png"), np.full((HEIGHT, WIDTH), 190, np.uint8))
    cv2.imwrite(str(folder / "images" / "d.png"), np.full((48, 64), 190, np.uint8))
    frames = locate(command, "images", "--out", "out")
    assert [frame["source"] for frame in frames] == ["a.png", "b.png", "c.png", "d.png"]
    assert frames[0]["status"] == "cannot be read" and frames[0]["markers"] == []
    check(frames[1])
    assert frames[2]["status"] == "no circle found" and frames[2]["markers"] == []
    assert "64 x 48 pixels" in frames[3]["status"] and frames[3]["markers"] == []
    assert {path.name for path in (folder / "out").iterdir()} == {
        "b_overlay.png",
        "c_overlay.png",
        "locate.json",
    }
    assert cv2.imread(str(folder / "out" / "b_overlay.png")).shape == (960, 1280, 3)


def test_glass_in_front_of_the_camera(command, folder):
    """5 mm of n = 1.5 shift a point closer by t (1 - 1/n) = 1.67 mm on the axis, off the axis by
    more (Eq. V8). In an image without glass, circles are estimated farther away by this
    distance."""
    (frame,) = locate(command, "dark.png", "--glass-mm", "5:1.5:60")
    further = np.array([m["center_mm"][2] for m in frame["markers"]]) - DEPTH_MM
    assert (further > 1.6).all() and (further < 2.2).all()


def test_bad_glass_is_named(command, folder):
    process = command(
        "detect-circles",
        "dark.png",
        "--camera",
        "camera.yaml",
        "--radius-mm",
        6,
        "--glass-mm",
        "5:0.5:100",
    )
    assert (
        process.returncode == 2 and "5:0.5:100" in process.stderr and "5:1.5:120" in process.stderr
    )


@pytest.mark.parametrize(
    ("name", "make", "words"),
    [
        ("no.png", lambda path: None, ["no.png", "no such file"]),
        ("bad.png", lambda path: path.write_bytes(b""), ["bad.png", "not an image"]),
        ("bad.mp4", lambda path: path.write_bytes(b"x"), ["bad.mp4", "video"]),
        ("empty", lambda path: path.mkdir(), ["empty", "contains no images"]),
        (
            "small.png",
            lambda path: cv2.imwrite(str(path), np.zeros((48, 64), np.uint8)),
            ["small.png", "64 x 48", "640 x 480"],
        ),
    ],
)
def test_bad_sources_are_named(command, folder, name, make, words):
    make(folder / name)
    process = command("detect-circles", name, "--camera", "camera.yaml", "--radius-mm", 6)
    assert process.returncode == 2 and process.stdout == ""
    line = process.stderr.strip().splitlines()[-1]
    assert [word for word in words if word not in line] == [] and "Traceback" not in process.stderr
