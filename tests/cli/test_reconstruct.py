"""Tests of `calibrate frame` and `reconstruct` on recorded frames of a sensor."""

import json

import cv2
import numpy as np
import pytest

from mjtactile.cli import main
from mjtactile.core.calibration import load_calibration
from mjtactile.sim.rendering.renderer import Renderer
from mjtactile.sim.scenes.indentation import Indenter, PressWorld


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """Render images of the flat, the inflated and the loaded membrane, with ground truth of the
    last."""
    folder = tmp_path_factory.mktemp("frames")
    world = PressWorld("dense", Indenter("sphere", 16e-3))
    view = Renderer(world.design, seed=0)

    def shoot(name, count):
        (folder / name).mkdir()
        for i in range(count):
            cv2.imwrite(str(folder / name / f"{i}.png"), view.render(*world.marker_poses(0)).pixels)

    world.inflate(0.0, seal=False)
    shoot("flat", 6)
    world.inflate(1000.0, seal=True)
    shoot("rest", 6)
    world.press(2e-3)
    shoot("press", 2)
    sensor = world.sensors[0]
    return folder, {
        "force": -world.drive_force[2],
        "volume_mL": 1e6 * (sensor.volume - world.design.chamber_volume_flat),
        "area_mm2": 1e6 * sensor.stretch_and_area()[1],
        "middle_mm": 1e3 * sensor.height_at(0.0, 0.0),
    }


def run_json(capsys, *args):
    assert main([*map(str, args), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_from_frames_to_surface_and_force(capsys, frames, tmp_path):
    folder, truth = frames
    calibration_file = tmp_path / "left.json"
    calibration = run_json(
        capsys,
        "calibrate",
        "frame",
        folder / "flat",
        "--rest",
        folder / "rest",
        "--out",
        calibration_file,
    )
    assert calibration["residual_px"] < 0.05  # centre noise of 0.02 px, averaged over six images
    # "dense" is rendered from its own file: camera and radii must be recovered within noise
    assert max(map(abs, calibration["offset_mm"])) < 0.02
    np.testing.assert_allclose(calibration["radius_mm"], 1.0, atol=2e-3)

    result = run_json(
        capsys,
        "reconstruct",
        folder / "press",
        "--calibration",
        calibration_file,
        "--out",
        tmp_path / "out",
    )
    assert [frame["source"] for frame in result["frames"]] == ["0.png", "1.png"]
    for frame in result["frames"]:
        assert frame["status"] == "ok" and len(frame["markers"]) == 81
        x, y, z = (np.array(frame["surface"][key]) for key in ("x_mm", "y_mm", "z_mm"))
        assert z.shape == (len(y), len(x))
        # under a ball: bench perception
        assert z[len(y) // 2, len(x) // 2] == pytest.approx(truth["middle_mm"], abs=0.04)
        # triangles cut the corners of the bulge: 1 % of its 1.3 mL at 13 x 11, and 20 uL is 17 um
        # of common depth
        assert frame["volume_mL"] == pytest.approx(truth["volume_mL"], abs=0.05)
        assert frame["area_mm2"] == pytest.approx(truth["area_mm2"], abs=2.0)
        assert -frame["force_N"][2] == pytest.approx(truth["force"], abs=0.04)  # the paper's error
        assert frame["depth_mm"] == pytest.approx(2.0, abs=0.2)
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"reconstruct.json", "0_overlay.png", "0_surface.png", "1_overlay.png"} <= written


def test_without_a_reference_the_estimate_is_unknown(capsys, frames):
    frame = run_json(capsys, "reconstruct", frames[0] / "press" / "0.png")["frames"][0]
    assert frame["status"] == "ok" and frame["surface"] is not None
    assert (
        frame["force_N"] is None and frame["contact_area_mm2"] is None and frame["depth_mm"] is None
    )


def test_frames_that_cannot_be_used_are_named(capsys, frames, tmp_path):
    mixed = tmp_path / "mixed"
    mixed.mkdir()
    (mixed / "a.png").write_bytes((frames[0] / "press" / "0.png").read_bytes())
    (mixed / "b.png").write_bytes(b"not a picture")
    cv2.imwrite(str(mixed / "c.png"), np.zeros((100, 100), np.uint8))
    cv2.imwrite(str(mixed / "d.png"), np.full((480, 640), 180, np.uint8))
    rows = run_json(capsys, "reconstruct", mixed)["frames"]
    assert [row["status"] for row in rows] == [
        "ok",
        "cannot be read",
        "the image has 100 x 100 pixels, but the sensor's camera has 640 x 480",
        "only 0 of 81 markers detected",
    ]
    assert rows[3]["surface"] is None


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("reconstruct", "nowhere"), ("nowhere", "no such file")),
        (("reconstruct", "{press}", "--calibration", "no.json"), ("no.json", "cannot be read")),
        (("calibrate", "frame", "--sensor", "paper16", "--out", "{tmp}/r.json"), ("FLAT", "--rig")),
        (("calibrate", "frame", "{press}", "--out", "nowhere/r.json"), ("nowhere", "--out")),
    ],
)
def test_bad_input_is_one_line(capsys, frames, tmp_path, args, words):
    code = main([a.format(press=frames[0] / "press", tmp=tmp_path) for a in args])
    captured = capsys.readouterr()
    assert code in (2, 3) and len(captured.err.strip().splitlines()) == 1
    assert all(word in captured.err for word in words)


def test_a_calibration_with_another_sensor_is_refused_with_its_reason(capsys, frames, tmp_path):
    out = tmp_path / "r.json"
    assert (
        main(
            [
                "calibrate",
                "frame",
                str(frames[0] / "press"),
                "--sensor",
                "paper16",
                "--out",
                str(out),
            ]
        )
        == 1
    )
    assert "REFUSED: sensor paper16: flat reference" in capsys.readouterr().out
    written = load_calibration(out)
    assert written.frame is None and "flat reference" in written.refused["frame"].reasons[0]


def test_images_of_another_sensor_have_no_surface(capsys, frames):
    """16 of the 81 small markers match those of `paper16`, which are larger: their estimated
    distance is too large."""
    folder, _ = frames
    result = run_json(capsys, "reconstruct", folder / "press", "--sensor", "paper16")
    for frame in result["frames"]:
        assert "would stretch the membrane to 1.6" in frame["status"]
        assert frame["area_mm2"] is None and frame["volume_mL"] is None
