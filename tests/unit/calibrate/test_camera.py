"""Tests of `calibrate camera` on images of a board rendered with OpenCV's camera model, and through
a live stream."""

import json
import threading

import cv2
import numpy as np
import pytest
import yaml

from mjtactile.calibrate.camera import Board, BoardFinder, calibrate_camera
from mjtactile.calibrate.interactive import collect_views
from mjtactile.cli import main
from mjtactile.core import scaled_clock
from mjtactile.core.optics import Camera
from mjtactile.emulator.mjpeg_server import StreamServer
from mjtactile.rig.file import load_rig_file

SIZE = (640, 480)
K = np.array([[610.0, 0, 325.3], [0, 606.0, 236.1], [0, 0, 1]])
DISTORTION = np.array([-0.21, 0.09, 8e-4, -6e-4, 0.0])
BOARD = Board(9, 7, 5e-3, 3.75e-3)
PIXELS = 60  # px per square of the rendered board


def rays():
    """Return undistorted (x, y) of each pixel, by OpenCV's inverse of its own model."""
    u, v = np.meshgrid(np.arange(SIZE[0], dtype=float), np.arange(SIZE[1], dtype=float))
    points = np.stack([u.ravel(), v.ravel()], axis=1)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
    return cv2.undistortPoints(points, K, DISTORTION, criteria=criteria).reshape(
        SIZE[1], SIZE[0], 2
    )


RAYS = rays()


def image(rotation, shift, seed, noise=2.0):
    """Render the board at a pose through K and DISTORTION: each pixel's ray is intersected with the
    board's plane."""
    R = cv2.Rodrigues(np.asarray(rotation, float))[0]
    inverse = np.linalg.inv(np.column_stack([R[:, 0], R[:, 1], shift]))
    ray = np.concatenate([RAYS, np.ones((*RAYS.shape[:2], 1))], axis=2) @ inverse.T
    xy = ray[..., :2] / ray[..., 2:]
    scale = PIXELS / BOARD.square
    sampled = BOARD.render(PIXELS)
    # pixel centres at integers; half a square of margin
    at = (xy * scale + PIXELS / 2 - 0.5).astype(np.float32)
    gray = cv2.remap(
        cv2.GaussianBlur(sampled, (0, 0), 1.5),
        at[..., 0],
        at[..., 1],
        cv2.INTER_LINEAR,
        borderValue=255,
    )
    rng = np.random.default_rng(seed)
    return np.clip(
        cv2.GaussianBlur(gray, (0, 0), 0.7) * 0.7 + 30 + rng.normal(0, noise, gray.shape), 0, 255
    ).astype(np.uint8)


def poses(count, tilt=0.5, spread=1.0):
    """Return board poses distributed over the view, tilted by up to `tilt` rad."""
    rng = np.random.default_rng(4)
    center = np.array([BOARD.columns, BOARD.rows]) * BOARD.square / 2
    for i in range(count):
        rotation = np.array([*rng.uniform(-tilt, tilt, 2), rng.uniform(-0.3, 0.3)])
        depth = rng.uniform(0.045, 0.065)
        aim = (
            spread
            * np.array([(-1, 1)[i % 2] * 0.16, (-1, 1)[i // 2 % 2] * 0.13])
            * rng.uniform(0.3, 1)
        )
        corner = cv2.Rodrigues(rotation)[0] @ np.array([*center, 0])
        yield rotation, np.array([*(aim * depth), depth]) - corner


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("photos")
    for i, pose in enumerate(poses(14)):
        cv2.imwrite(str(folder / f"{i:02d}.png"), image(*pose, seed=i))
    return folder


def test_known_intrinsics_are_recovered(photos, tmp_path, capsys):
    out = tmp_path / "camera.yaml"
    assert main(["calibrate", "camera", str(photos), "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    camera = Camera.from_file(out)  # the pipeline reads the written file
    sd = result["sd"]
    # Each within 4 of its own standard deviations, with a floor of 0.1 px: the bias of corner
    # refinement.
    for name, true in (("fx", 610.0), ("fy", 606.0), ("cx", 325.3), ("cy", 236.1)):
        assert abs(getattr(camera, name) - true) < max(4 * sd[name], 0.1), name
        assert sd[name] < 0.005 * 610
    grid = np.stack(
        np.meshgrid(np.linspace(-0.4, 0.4, 9), np.linspace(-0.3, 0.3, 7)), axis=-1
    ).reshape(-1, 2)
    plane = np.column_stack([grid, np.ones(len(grid))])
    observed = [
        cv2.projectPoints(plane, np.zeros(3), np.zeros(3), k, d)[0].reshape(-1, 2)
        for k, d in ((K, DISTORTION), (camera.K, np.array(camera.distortion)))
    ]
    inside = ((observed[0] > 20) & (observed[0] < np.array(SIZE) - 20)).all(axis=1)
    off = (observed[0] - observed[1])[inside]
    # px, all over the view; a common shift is a turn of the camera by less than a milliradian,
    # which `frame` measures
    assert np.linalg.norm(off - off.mean(axis=0), axis=1).max() < 0.5
    # blurred corners of 50 px squares: 0.17 px each way
    assert result["rms_px"] < 0.3 and result["holdout_px"] < 0.35
    table = yaml.safe_load(out.read_text())
    assert table["calibration"]["verdict"] == "good" and table["calibration"]["versions"]["opencv"]
    assert table["distortion_model"] == "plumb_bob" and table["projection_matrix"]["cols"] == 4


def views_of(images):
    finder = BoardFinder(BOARD)
    return finder, [view for i, gray in enumerate(images) if (view := finder.find(str(i), gray))]


def test_a_board_that_was_never_tilted_is_refused():
    finder, views = views_of(image(*pose, seed=i) for i, pose in enumerate(poses(9, tilt=0.02)))
    assert any("tilted" in reason for reason in calibrate_camera(finder, views, SIZE).reasons)


def test_too_few_images_of_the_center_are_refused(tmp_path, capsys):
    for i, pose in enumerate(poses(5, spread=0.1)):
        cv2.imwrite(str(tmp_path / f"{i}.png"), image(*pose, seed=i))
    out = tmp_path / "camera.yaml"
    assert main(["calibrate", "camera", str(tmp_path), "--out", str(out)]) == 1
    text = capsys.readouterr().out
    assert "REFUSED" in text and "8 are needed" in text
    assert not out.exists()  # a good file is never replaced
    assert (
        yaml.safe_load((tmp_path / "camera.refused.yaml").read_text())["calibration"]["verdict"]
        == "refused"
    )


def test_an_image_of_a_bent_board_is_left_out(photos):
    gray = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(photos.glob("*.png"))]
    finder, views = views_of(gray)
    bent = views[3].uv + 6 * np.sin(views[3].uv / 30)  # a board that is not flat
    views[3] = type(views[3])("bent", views[3].ids, bent)
    fit = calibrate_camera(finder, views, SIZE)
    assert fit.dropped == ("bent",) and not fit.reasons


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ("SOURCE", "--rig")),
        (["nowhere", "--out", "left.json"], ("nowhere",)),
        (["x"], ("needs a target", "--rig", "--out")),
        (["--print", "no/board.png"], ("--print", "no")),
        (["x", "--board", "9"], ("--board", "9x7")),
        (["x", "--dictionary", "Q"], ("--dictionary", "4X4_50")),
        (["x", "--marker-mm", "6"], ("--marker-mm",)),
        (["x", "--out", "no/camera.yaml"], ("--out", "no")),
    ],
)
def test_bad_input_names_the_field(arguments, words, capsys):
    assert main(["calibrate", "camera", *arguments]) == 2
    text = capsys.readouterr().err
    assert all(word in text for word in words), text


def test_live_views_are_stored_when_the_board_rests_at_a_new_pose():
    finder = BoardFinder(BOARD)
    still = [image(*pose, seed=i) for i, pose in enumerate(poses(3))]
    frames = [still[0], still[1], still[1], still[1], still[2], still[2], still[1], still[1]]
    reported = []
    views = collect_views(
        ((str(i), gray) for i, gray in enumerate(frames)), finder, 10, reported.append
    )
    # moving: no; resting: once; again at an earlier pose: no
    assert [view.name for view in views] == ["2", "5"]
    assert len(reported) == 2


@pytest.mark.clock(9)
def test_live_calibration_reads_a_stream(photos, tmp_path, capsys):
    """The driver of a network camera, the stream's JPEG, the guided choice of views: the same
    camera."""
    images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(photos.glob("*.png"))]
    server = StreamServer(("left",))
    stop = scaled_clock.Event()

    def play():
        count = 0
        while not stop.wait(0.06):
            noise = np.random.default_rng(count).integers(0, 2, images[0].shape, dtype=np.uint8)
            server.publish("left", cv2.add(images[count // 4 % len(images)], noise))
            count += 1

    thread = threading.Thread(target=play)
    thread.start()
    lines = []
    inside = False
    sources = iter((server.url("left"), "another"))
    # only its camera is used: no [emulator]
    for line in load_rig_file("emulated").path.read_text().splitlines():
        inside = line.startswith("[emulator]") or inside and not line.startswith("[")
        if not inside:
            lines.append(
                f'source = "{next(sources)}"' if line.startswith('source = "emulator"') else line
            )
    rig = tmp_path / "rig.toml"
    rig.write_text("\n".join(lines))
    try:
        start = scaled_clock.monotonic()
        code = main(
            [
                "calibrate",
                "camera",
                "--rig",
                str(rig),
                "--views",
                "12",
                "--seconds",
                "30",
                "--out",
                str(tmp_path / "left.yaml"),
                "--json",
            ]
        )
        assert (
            scaled_clock.monotonic() - start < 30 + 15
        )  # never more than was allowed, and connecting
    finally:
        stop.set()
        thread.join()
        server.close()
    result = json.loads(capsys.readouterr().out)
    assert code == 0, result["reasons"]
    # JPEG moves corners slightly
    assert abs(result["camera_matrix"]["data"][0] - 610) < max(4 * result["sd"]["fx"], 0.5)
