"""Tests of `mjtactile design`: predictions follow closed forms, and the output is sensor files."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from mjtactile import InputError, load_sensor
from mjtactile.cli import main
from mjtactile.design_study import design_sweep, predict_file, sensor_file_edit
from mjtactile.design_study.resolution import ResolutionPredictor, ball, position_sd
from mjtactile.design_study.score import Score
from mjtactile.design_study.virtual_bench import VirtualBench

MIDDLE = np.zeros(2)
PLACES = ((1e-3, 0.7e-3), (-3.1e-3, 2.2e-3), (4.3e-3, -1.4e-3))


@pytest.fixture(scope="module")
def paper16():
    return VirtualBench(load_sensor("paper16"))


def test_a_marker_is_known_as_a_circle_of_its_pixels_is(paper16):
    # linear in the noise of a pixel. A circle's radius in the image is proportional to f, and so is
    # the edge length for averaging; a pixel is worth depth / f: f^-3/2 in total
    design = paper16.design
    camera = design.camera
    rest = paper16.film.rest

    def sd(changed):
        return np.sqrt(np.trace(VirtualBench(changed).detect_markers(rest).cov_p, axis1=1, axis2=2))

    def with_camera(**values):
        return replace(design, camera=replace(camera, **values))

    own = sd(design)
    # rounding adds a twelfth of a squared grey level: 1 % at 1 DN
    noisy = sd(with_camera(noise_dn=4.0)) / own
    np.testing.assert_allclose(noisy, 2.0, rtol=0.02)
    longer = sd(sensor_file_edit.scaled_lens(design, 1.3)) / own
    # the chain's tilt comes in a little, and more blur for its radius
    np.testing.assert_allclose(longer, 1.3**-1.5, rtol=0.06)


def test_noise_of_the_force_bounds_the_scatter_of_drawn_images(paper16):
    # the chain's linear step in closed form, against forty images with sampled errors
    pressed = paper16.press(ball(MIDDLE, 8e-3), 0.5)
    felt = paper16.estimate_touch(pressed.state)
    said = math.sqrt(paper16.noise(felt)[2, 2])
    forces = []
    for number in range(40):
        seen = paper16._sampler.sample(*paper16.poses(pressed.state.x), 0.1)
        touch, _ = paper16.pipeline.step(felt.state, replace(seen, time=0.1 + number), 0.1 + number)
        forces.append(touch.traction.wrench[2])
    # a bound: forty numbers give their sd to 11 %; a chain that keeps the camera state between
    # images scatters by half of the value for one image alone
    assert 0.35 * said < np.std(forces) < 1.3 * said
    assert -np.mean(forces) == pytest.approx(0.5, rel=0.03)


def test_twice_the_markers_tell_an_edge_by_the_root_of_two_better():
    # each marker's height is an independent measurement of the edge; equal size gives equal noise
    few = sensor_file_edit.with_markers(load_sensor("dense"), 7, 9, (32e-3, 24e-3), 0.2)
    many = sensor_file_edit.with_markers(load_sensor("dense"), 10, 13, (32e-3, 24e-3), 0.2)
    radius = 0.6e-3
    sds = []
    for design in (few, many):
        design = replace(design, markers=replace(design.markers, radius=radius))
        reacher = ResolutionPredictor(VirtualBench(design))
        edges = [reacher.edge_sd(np.array(place), 0.3) for place in PLACES]
        sds.append(np.sqrt(np.mean(np.square(edges))))
    wanted = math.sqrt(many.markers.count / few.markers.count)
    # the marker positions around an edge matter in addition to their number
    assert sds[0] / sds[1] == pytest.approx(wanted, rel=0.35)


def test_place_of_a_force():
    # 2 N at (3, -1) mm on the plane z = 4 mm: M = r x F; an sd of 1 mN m about y is one of 0.5 mm
    r, force = np.array([3e-3, -1e-3, 4e-3]), np.array([0.0, 0.0, -2.0])
    wrench = np.concatenate([force, np.cross(r, force)])
    cov = np.zeros((6, 6))
    cov[4, 4] = 1e-6
    assert position_sd(wrench, cov, r[2]) == pytest.approx(0.5e-3)
    # an sd of the force itself moves the position by its fraction of the arm
    cov = np.zeros((6, 6))
    cov[2, 2] = 0.1**2
    assert position_sd(wrench, cov, r[2]) == pytest.approx(3e-3 * 0.1 / 2)


@pytest.mark.parametrize("name", ["dense", "paper16", "fine", "dense_fiducials"])
def test_a_written_file_is_the_sensor(tmp_path, name):
    design = load_sensor(name)
    path = tmp_path / f"{name}.toml"
    path.write_text(sensor_file_edit.sensor_text(design, "two\nlines"))
    assert load_sensor(path) == design


def test_front():
    # force, edge, markers: the third is beaten by the first in all three, the fourth misses more
    rows = [(1.0, 4.0, 9), (4.0, 1.0, 9), (2.0, 5.0, 9), (0.5, 0.5, 9), (4.0, 2.0, 4)]
    missed = [(), (), (), ("edge",), ()]
    design = load_sensor("dense")

    def tried(force, edge, side, missed):
        score = Score(0.02, 0.01, force, 0.0, 0.0, edge, 0.0, 1.0)
        made = sensor_file_edit.with_markers(design, side, side, (30e-3, 20e-3), 0.2)
        return design_sweep.DesignCandidate(made, score, missed)

    all_of_them = [tried(*row, words) for row, words in zip(rows, missed, strict=True)]
    marked = design_sweep.with_front(all_of_them)
    assert [one.on_front for one in marked] == [True, True, False, False, True]
    best = design_sweep.best(marked, 2)
    assert [one.score.force_sd for one in best] == [1.0, 4.0]


def test_what_is_missed():
    reached = Score(0.02, 0.01, 0.01, 0.003, 1e-4, 1e-4, math.nan, 3.0)
    assert design_sweep.Requirements(touch=0.01, maximum=3.0, edge=1e-4).missed(reached) == []
    assert design_sweep.Requirements(touch=0.009, maximum=4.0).missed(reached) == ["touch", "range"]
    assert design_sweep.Requirements(radius=5e-3).missed(reached) == ["radius"]  # not determined


def test_markers_out_of_the_picture_are_refused():
    with pytest.raises(InputError, match=r"circles lie completely in the image"):
        VirtualBench(sensor_file_edit.scaled_lens(load_sensor("dense"), 1.9))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--force-N", "0"], "--force-N"),
        (["--detect-force-mN", "-3"], "--detect-force-mN"),
        (["--edge-mm", "0.1", "--count", "0"], "--count"),
        (["--frame-mm", "3,3"], "--frame-mm"),
        (["--sensor", "no_such"], "no_such"),
    ],
)
def test_bad_input(capsys, options, words):
    assert main(["design", *options]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.slow(10)
def test_a_wish_becomes_sensor_files(tmp_path, capsys):
    options = ["--sensor", "paper16", "--detect-force-mN", "12", "--count", "2", "--json"]
    assert main(["design", *options, "--out", str(tmp_path / "out")]) == 0
    result = json.loads(capsys.readouterr().out)
    assert len(result["candidates"]) == 2 and any(one["on_front"] for one in result["candidates"])
    for best in result["best"]:
        made = load_sensor(tmp_path / "out" / best["file"])
        assert made.markers.rows == best["rows"]
        assert 1e-3 * made.chamber.supply_gauge == pytest.approx(best["supply_pressure_kPa"])


@pytest.mark.slow(10)
def test_a_file_has_a_map_and_a_page(tmp_path, capsys, monkeypatch):
    # nine places, and one of the changes that are all scored alike
    monkeypatch.setattr(predict_file, "_SPACING", 20e-3)
    variants = predict_file.variants
    monkeypatch.setattr(predict_file, "variants", lambda *words: list(variants(*words))[:1])
    assert main(["design", "--sensor", "paper16", "--json", "--out", str(tmp_path / "out")]) == 0
    result = json.loads(capsys.readouterr().out)
    assert {"design.json", "design.html"} <= {path.name for path in (tmp_path / "out").iterdir()}
    # the frame's corners are drawn 533 px apart of 640
    assert result["picture"]["width_used"] == pytest.approx(533 / 640, abs=0.02)
    middle = next(one for one in result["face"] if one["x_mm"] == one["y_mm"] == 0)
    rim = max(result["face"], key=lambda one: abs(one["x_mm"]) + abs(one["y_mm"]))
    assert middle["force_sd_mN"] < rim["force_sd_mN"]


def test_a_round_sensor_reaches_as_much_where_it_is_turned(capsys):
    reacher = ResolutionPredictor(VirtualBench(load_sensor("round30")))
    place = np.array([5e-3, 2e-3])
    here, opposite = (reacher.at(at, 0.5) for at in (place, -place))
    # the layout is the same turned by half; the film's tolerance of 0.5 um is 1 mN
    assert here.felt == pytest.approx(opposite.felt, abs=2e-3)
    assert here.force_sd == pytest.approx(opposite.force_sd, rel=0.02)
    assert here.edge_sd < 0.5e-3
    assert here.felt == pytest.approx(0.5, rel=0.02)  # the error is 1 mN
    outside = reacher.at(np.array([12e-3, 12e-3]), 0.5)  # within the rectangle about it
    assert np.isnan([outside.felt, outside.force_sd, outside.edge_sd]).all()
    assert main(["design", "--sensor", "round30", "--detect-force-mN", "20"]) != 0
    assert "supports rectangles only" in capsys.readouterr().err
