"""Tests of the evaluation of standard deviations: on synthetic images of known chi-square, and on
one short scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.uncertainty.evaluate_scene import watch
from benchmarks.uncertainty.run import run, scene_rows
from benchmarks.uncertainty.scenes import FINE, FINE_FROM, KINDS, SENSORS, sample_scene
from benchmarks.uncertainty.tables import summary, table
from mjtactile.sim.scenes.indentation import Indenter

SD = np.array([1e-3, 2e-3, 8e-3, 1e-5, 2e-5, 3e-5])


def image(z, true=(0.0, 0.0, -0.5, 0.0, 0.0, 0.0), **more):
    """Return a row with an error of `z` (6,) standard deviations."""
    row = {
        "time": 0.0,
        "status": "ok",
        "touching": True,
        "rattles": False,
        "wrench_true": list(true),
        "sd": SD.tolist(),
        "wrench": (np.array(true) + z * SD).tolist(),
        "area": None,
        "area_true": None,
    }
    return row | more


def scene(*rows, **more):
    return {
        "seed": 0,
        "kind": "press",
        "shape": "sphere",
        "sensor": "dense",
        "flags": [],
        "error": "",
        "rows": rows,
    } | more


def test_chi_square_is_that_of_errors_sampled_from_the_error_bars():
    rng = np.random.default_rng(0)
    result = summary([scene(*(image(z) for z in 1.5 * rng.standard_normal((400, 6))))])
    found = result["groups"]["touches"]
    # 400 squares: 7 %, six of them
    np.testing.assert_allclose(found["chi_square"], 1.5**2, rtol=0.3)
    assert found["images"] == 400 and result["status"] == {"ok": 400}


def test_far_estimates_are_counted_and_images_without_touch_are_not():
    far = np.array([0, 0, -6.0, 0, 0, 0])
    lost = image(far, status="fit failed", wrench=None, sd=None)
    rows = [
        image(np.zeros(6)),
        image(far),
        lost,
        image(far, rattles=True),
        image(far, true=np.zeros(6)),
        image(far, true=(0, 0, -0.01, 0, 0, 0)),
    ]
    flagged = scene(image(far), seed=1, flags=["edge", "wrinkles"])
    groups = summary([scene(*rows), flagged])["groups"]
    assert (
        groups["touches"]["images"] == 2
        and groups["touches"]["far_any"] == groups["touches"]["far"][2] == 1
    )
    assert (
        groups["nothing touches"]["far_any"] == 1
        and groups["touches that the simulation flags"]["far_any"] == 1
    )
    assert groups["touches at rest whose true force rattles"]["images"] == 1
    assert (
        groups["everything that is ok"]["images"] == 6
        and groups["everything that is ok"]["far_scenes"] == 2
    )
    assert groups["touches"]["worst"][2] == pytest.approx(6.0)


def test_areas_are_compared_if_both_are_known():
    rows = [
        image(np.zeros(6), area=20e-6, area_true=10e-6),
        image(np.zeros(6), area=10.5e-6, area_true=10e-6),
        image(np.zeros(6), area=20e-6),
        image(np.zeros(6), area_true=10e-6),
    ]
    areas = summary([scene(*rows)])["areas"]
    assert areas["all"]["images"] == 2 and areas["all"]["within_10_percent"] == 0.5
    assert areas["all"]["median_error"] == pytest.approx(0.525)
    assert "from 0.5 N on" in table(summary([scene(*rows)]))


def test_scenes_alternate_and_match_their_description():
    sampled = [sample_scene(seed) for seed in range(40)]
    assert {scene.kind for scene in sampled} == set(KINDS) and {
        scene.sensor for scene in sampled
    } == set(SENSORS)
    fine = [sample_scene(FINE_FROM + seed) for seed in range(20)]
    assert {scene.sensor for scene in fine} == set(FINE)
    for item in [*sampled, *fine]:
        frame = item.design.frame
        assert abs(item.at[0]) < frame.length / 2 and abs(item.at[1]) < frame.width / 2
        assert (item.shake[0] > 0) == (item.kind == "shaken")
    near = [
        np.min([20e-3 - abs(s.at[0]), 15e-3 - abs(s.at[1])]) for s in sampled if s.kind == "edge"
    ]
    assert max(near) < 12e-3  # a face's half width and a margin
    coarse = next(s for s in sampled if s.sensor == "dense at half resolution").design.camera
    assert (coarse.width, coarse.fx) == (320, 300.0)
    assert sample_scene(7) == sample_scene(7)


def test_a_short_scene_is_estimated_within_its_error_bars():
    one = replace(
        sample_scene(3),
        mesh=(13, 11),
        indenter=Indenter("sphere", 8e-3),
        at=(1e-3, 2e-3),
        depth=2e-3,
        speed=0.1,
    )
    watched = watch(one)
    forces = np.array([-sample.wrench[2] for sample in watched.samples])
    assert one.kind == "tap" and forces.max() > 0.2 and forces[-1] == 0.0
    touched = [
        sample
        for sample in watched.samples
        if sample.wrench[2] < -0.02 and sample.touch.traction is not None
    ]
    assert len(touched) > 6 and any(np.isfinite(sample.area) for sample in touched)
    z = np.array(
        [
            (sample.touch.traction.wrench - sample.wrench)[2] / sample.touch.force_normal_sd
            for sample in touched
        ]
    )
    assert np.abs(z).max() < 5  # required of every image


def test_finished_pieces_are_kept(tmp_path, monkeypatch):
    calls = []

    def rows(seed):
        calls.append(seed)
        return scene(image(np.zeros(6)), seed=seed)

    class Inline:
        def __init__(self, **_): ...
        def __enter__(self):
            return self

        def __exit__(self, *_): ...

        map = staticmethod(map)

    monkeypatch.setattr("benchmarks.uncertainty.run.ProcessPoolExecutor", Inline)
    monkeypatch.setattr("benchmarks.uncertainty.run.scene_rows", rows)
    first = run(tmp_path, quick=True)
    (tmp_path / "scenes" / f"{calls[0]}.json").unlink()
    assert run(tmp_path, quick=True, resume=True)["groups"].keys() == first["groups"].keys()
    assert calls[4:] == calls[:1]


def test_a_scene_that_cannot_be_simulated_is_reported(monkeypatch):
    from mjtactile.core.errors import SimulationError

    def broken(_):
        raise SimulationError("the state\n is not finite", step=1, time=0.1)

    monkeypatch.setattr("benchmarks.uncertainty.run.watch", broken)
    found = scene_rows(5)
    assert found["rows"] == [] and "not finite" in found["error"] and summary([found])["failed"]
