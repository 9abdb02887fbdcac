"""Tests of tracking the dots of any skin through rendered images with known dot positions."""

import csv
import json

import cv2
import numpy as np
import pytest

from mjtactile import Camera, InputError, load_sensor, track_circles
from mjtactile.cli import main
from mjtactile.sim.rendering.renderer import Renderer

RADIUS, PITCH, ZOOM = 9.0, 44.0, 8
GRID = np.stack(np.meshgrid(np.arange(6), np.arange(4)), axis=-1).reshape(-1, 2)
START = GRID * PITCH + [50.0, 54.0]


def image_of(places, *, bright=False, noise=0):
    """Render dots on an uneven background, supersampled: edges are one pixel wide."""
    fine = np.zeros((240 * ZOOM, 320 * ZOOM), np.uint8)
    for u, v in (np.asarray(places) + 0.5) * ZOOM - 0.5:
        center = (round(u * 16), round(v * 16))
        cv2.circle(fine, center, round(RADIUS * ZOOM * 16), 255, -1, cv2.LINE_AA, 4)
    dots = cv2.resize(fine, (320, 240), interpolation=cv2.INTER_AREA).astype(float) / 255
    dots = cv2.GaussianBlur(dots, None, 0.8)
    ground = 110 + 40 * np.linspace(0, 1, 320)[None, :]
    grey = ground * (1 - dots) + 20 * dots
    grey = grey + np.random.default_rng(noise).normal(0, 1.5, grey.shape)
    return np.clip(255 - grey if bright else grey, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("bright", [False, True])
def test_every_dot_keeps_its_number(bright):
    # once, all dots jump together by half a pitch, so that some are closer to a neighbour's old
    # position; in addition each wanders by a few pixels
    rng = np.random.default_rng(3)
    wander = np.cumsum(rng.normal(0, 1.2, (8, len(START), 2)), axis=0)
    common = np.array([[0, 0], [2, 1], [24, 12], [24, 12], [10, 0], [0, 0], [-8, 3], [0, 0]])
    truth = [START + w + c for w, c in zip(wander, common, strict=True)]
    images = [image_of(places, bright=bright, noise=n) for n, places in enumerate(truth)]
    polarity = "bright" if bright else "dark"
    number = {}
    for places, tracked in zip(truth, track_circles(images, polarity=polarity), strict=True):
        assert (tracked.ids >= 0).all() and len(tracked.ids) == len(START)
        distance = np.linalg.norm(tracked.ellipses.center_px[:, None] - places[None], axis=2)
        # 1.5 grey levels of noise on an edge of 100: some hundredths of a pixel
        assert distance.min(axis=1).max() < 0.1
        found = dict(zip(distance.argmin(axis=1).tolist(), tracked.ids.tolist(), strict=True))
        assert number in ({}, found)
        number = found


@pytest.mark.parametrize("jump", [(30, 0), (-30, 8), (26, 28), (44, 0)])
def test_a_jump_by_more_than_half_a_pitch_keeps_the_numbers(jump):
    """The pattern resembles itself moved by one pitch, except at its edges."""
    small = START[(GRID[:, 0] > 0) & (GRID[:, 0] < 4) & (GRID[:, 1] < 3)] + [0.0, 10.0]
    before, after = track_circles([image_of(small), image_of(small + jump, noise=1)])
    places = dict(zip(before.ids.tolist(), before.ellipses.center_px, strict=True))
    assert len(places) == 9
    moved = [
        center - places[number]
        for number, center in zip(after.ids.tolist(), after.ellipses.center_px, strict=True)
    ]
    assert np.abs(np.array(moved) - jump).max() < 0.1


def test_a_pattern_beyond_the_image_keeps_its_numbers_as_it_passes():
    """Columns enter and leave at the borders; none of them is a jump."""
    wide = np.stack(np.meshgrid(np.arange(-6, 7), np.arange(4)), axis=-1).reshape(-1, 2) * PITCH
    at = {}
    for step in range(14):
        truth = wide + [60.0 + 9.0 * step, 54.0]
        at[step] = truth
    numbers = {}
    for step, tracked in enumerate(track_circles(image_of(at[k], noise=k) for k in at)):
        distance = np.linalg.norm(tracked.ellipses.center_px[:, None] - at[step][None], axis=2)
        for dot, number in zip(distance.argmin(axis=1).tolist(), tracked.ids.tolist(), strict=True):
            if number >= 0:
                assert numbers.setdefault(dot, number) == number
    assert len(numbers) > 30


def test_a_covered_dot_keeps_its_number_when_it_reappears():
    images = [image_of(START), image_of(np.delete(START, 8, axis=0) + 2), image_of(START + 4)]
    first, without, again = track_circles(images)

    def id_at(tracked, place):
        return tracked.ids[np.linalg.norm(tracked.ellipses.center_px - place, axis=1).argmin()]

    own = id_at(first, START[8])
    assert own not in without.ids
    assert id_at(again, START[8] + 4) == own


def test_positions_in_space_with_known_camera_and_radius():
    # image of a sensor; only lens and radius are given
    design = load_sensor("paper16")
    p_SM = design.markers.p_SM
    image = Renderer(design, seed=1).render(p_SM, np.tile([0.0, 0.0, -1.0], (len(p_SM), 1)))
    camera = Camera.from_design(design.camera, design.glass)
    (tracked,) = track_circles([image], camera, design.markers.radius)
    assert tracked.poses is not None
    observed = tracked.poses.p_CM + design.camera.p_SC
    distance = np.linalg.norm(observed[:, None] - p_SM[None], axis=2)
    # depth of a circle of 20 px radius that is known to some thousandths: 10 to 30 um
    assert sorted(distance.argmin(axis=1)) == list(range(16)) and distance.min(axis=1).max() < 1e-4


def test_a_folder_of_frames_becomes_a_table(tmp_path, capsys):
    (tmp_path / "in").mkdir()
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"in/{number}.png"), image_of(START + number))
    out = tmp_path / "out"
    options = ["reconstruct", str(tmp_path / "in"), "--marks", "dark", "--out", str(out), "--json"]
    assert main(options) == 0
    result = json.loads(capsys.readouterr().out)
    assert [frame["trusted"] for frame in result["frames"]] == [24, 24, 24]
    assert [track["frames"] for track in result["tracks"]] == [3] * 24
    with (out / "tracks.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    one = [row for row in rows if row["id"] == "0"]
    assert [float(row["u_px"]) - float(one[0]["u_px"]) for row in one] == pytest.approx(
        [0, 1, 2], abs=0.1
    )
    assert one[0]["x_mm"] == "" and (out / "tracks.png").exists()


def test_bad_input(tmp_path, capsys):
    cv2.imwrite(str(tmp_path / "one.png"), image_of(START))
    source = str(tmp_path / "one.png")
    for options in (["--radius-mm", "1"], ["--marks", "dark", "--radius-mm", "1"]):
        assert main(["reconstruct", source, *options]) == 2
        assert "--radius-mm" in capsys.readouterr().err
    with pytest.raises(InputError, match="must be given together"):
        next(track_circles([image_of(START)], radius=1e-3))


def test_a_camera_file_of_another_size_is_refused(tmp_path, capsys):
    """Otherwise positions in mm would be wrong by the ratio of the sizes."""
    cv2.imwrite(str(tmp_path / "one.png"), image_of(START))
    camera = tmp_path / "camera.yaml"
    camera.write_text("width: 64\nheight: 48\nk: [50, 0, 32, 0, 50, 24, 0, 0, 1]\nd: []\n")
    options = ["--marks", "dark", "--camera", str(camera), "--radius-mm", "1"]
    assert main(["reconstruct", str(tmp_path / "one.png"), *options]) == 2
    message = capsys.readouterr().err
    assert "one.png" in message and "but the camera file has 64 x 48" in message
