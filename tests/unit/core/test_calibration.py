"""Tests of `Calibration`: the file, its parts, and its changes to a design, a traction and a
pressure."""

import json
from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core.calibration import Calibration, load_calibration
from mjtactile.core.calibration_parts import (
    KINDS,
    ForceScale,
    FrameCalibration,
    LensCalibration,
    RestMarkers,
    ValveZero,
    stamp,
)
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.types import Markers, Traction

DESIGN = load_sensor("dense")
COUNT = DESIGN.markers.count


def made(kind):
    """Return a new part of that kind."""
    mark = stamp(DESIGN, {"mjtactile": "1"}, {"rms_px": 0.1})
    rest = RestMarkers(
        Markers(np.arange(3), np.eye(3) * 1e-3, np.eye(3), np.tile(1e-12 * np.eye(3), (3, 1, 1))),
        970.0,
        True,
    )
    return {
        "lens": lambda: LensCalibration(
            640, 480, 618.0, 617.0, 325.5, 235.5, (-0.09, 0.01, 0.0, 0.0, 0.0), stamp=mark
        ),
        "frame": lambda: FrameCalibration(
            np.eye(3),
            np.array([4e-4, 0, -0.045]),
            np.full(COUNT, 1.02),
            0.01,
            1e-3,
            mark,
            rest,
            1.15,
        ),
        "valve": lambda: ValveZero(30.0, 5.0, mark),
        "force": lambda: ForceScale(0.98, 0.01, 1.5, mark),
    }[kind]()


def complete():
    calibration = Calibration("left", "dense")
    for kind in KINDS:
        calibration = calibration.with_part(made(kind))
    return calibration


def states(calibration, design=DESIGN):
    return {state.kind: state.state for state in calibration.states(design)}


def test_a_saved_calibration_is_read_back(tmp_path):
    path = tmp_path / "left.json"
    first = complete().with_refusal("force", ["loads slid"])
    first.save(path)
    again = load_calibration(path)
    assert json.dumps(again.table()) == json.dumps(first.table())
    # mm and back: rounding only
    assert again.frame.rest.markers.p_SM == pytest.approx(1e-3 * np.eye(3), abs=1e-18)
    assert again.refused["force"].reasons == ("loads slid",)
    assert not list(tmp_path.glob("*.part"))


def test_a_calibration_changes_only_the_lens_of_the_design():
    changed = complete().design(DESIGN)
    assert (changed.camera.fx, changed.camera.cy, changed.camera.distortion[0]) == (
        618.0,
        235.5,
        -0.09,
    )
    assert replace(changed, camera=DESIGN.camera) == DESIGN
    assert Calibration("left", "dense").design(DESIGN) is DESIGN


def test_the_zero_of_the_valve_and_the_scale_of_the_force():
    assert (
        complete().pressure(1000.0) == 970.0
        and Calibration("left", "dense").pressure(1000.0) == 1000.0
    )
    wrench = np.array([0.1, 0.0, -2.0, 0, 0, 0])
    cov = np.diag([1e-4] * 6)
    observed = Traction(
        np.arange(3.0), np.arange(2.0), np.ones((2, 3, 3)), wrench, cov, 970.0, "inverse"
    )
    out = ForceScale(0.5, 0.01, 1.5, stamp(DESIGN, {}, {})).apply(observed)
    assert out.wrench == pytest.approx(0.5 * wrench) and out.force == pytest.approx(
        0.5 * observed.force
    )
    # Independent errors: variance of k w is k^2 var(w) + var(k) w^2
    assert out.wrench_cov[2, 2] == pytest.approx(0.25 * 1e-4 + (0.01 * 2.0) ** 2)
    assert out.gauge_pressure == 970.0


def test_a_refused_part_replaces_no_value_and_is_stored_until_it_succeeds():
    good = complete()
    refused = good.with_refusal("lens", ["too few pictures"])
    assert refused.lens is good.lens and states(refused)["lens"] == "good"
    assert "too few pictures" in next(s.text for s in refused.states(DESIGN) if s.kind == "lens")
    assert not refused.with_part(made("lens")).refused
    never = Calibration("left", "dense").with_refusal("lens", ["too few pictures"])
    assert states(never)["lens"] == "refused" and states(never)["force"] == "missing"


def test_parts_older_than_the_sensor_file_or_their_inputs_are_not_used():
    calibration = complete()
    assert set(states(calibration).values()) == {"good"}
    stiffer = replace(DESIGN, membrane=replace(DESIGN.membrane, young=1.2e6))
    assert states(calibration, stiffer) == {
        "lens": "good",
        "frame": "outdated",
        "valve": "good",
        "force": "outdated",
    }
    used = calibration.used(stiffer)
    assert used.force is None and used.frame is None and used.lens is calibration.lens
    later = replace(
        made("lens"), stamp=replace(calibration.lens.stamp, date="2999-01-01T00:00:00.000+00:00")
    )
    assert states(calibration.with_part(later)) == {
        "lens": "good",
        "frame": "outdated",
        "valve": "good",
        "force": "outdated",
    }


@pytest.mark.parametrize(
    ("finger", "design", "words"),
    [
        ("right", DESIGN, ("'left'", "'right'")),
        ("left", load_sensor("paper16"), ("'dense'", "'paper16'")),
        (
            "left",
            replace(DESIGN, camera=replace(DESIGN.camera, width=1280)),
            ("640 x 480", "1280 x 480"),
        ),
    ],
)
def test_a_calibration_of_another_device_is_refused(finger, design, words):
    with pytest.raises(InputError) as caught:
        complete().check(design, finger, "left.json")
    assert all(word in str(caught.value) for word in ("left.json", *words))


def broken(change):
    table = json.loads(json.dumps(complete().table()))
    change(table)
    return json.dumps(table)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (json.dumps(complete().table())[:2000], ("not valid JSON",)),  # cut in half
        ("[]", ("not a calibration file", "mjtactile-calibration version 1")),
        (broken(lambda t: t.update(version=2)), ("not a calibration file",)),
        (broken(lambda t: t.pop("finger")), ("finger", "missing")),
        (broken(lambda t: t["lens"].pop("fx_px")), ("lens.fx_px", "missing")),
        (broken(lambda t: t["lens"].update(distortion=[1, 2])), ("lens.distortion", "5 numbers")),
        (broken(lambda t: t["frame"].update(R_SC=[[1, 0], [0, 1]])), ("frame.R_SC", "3 x 3")),
        (broken(lambda t: t["frame"]["rest"].update(n_S=[[None, 0, 1]])), ("frame.rest.n_S",)),
        (broken(lambda t: t["force"].update(scale=0)), ("force.scale", "outside")),
        (broken(lambda t: t["valve"].update(date=3)), ("valve.date", "not text")),
    ],
)
def test_a_broken_file_is_one_line_with_file_and_field(tmp_path, text, words):
    path = tmp_path / "left.json"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_calibration(path)
    message = str(caught.value)
    assert (
        "\n" not in message and "left.json" in message and all(word in message for word in words)
    ), message


def test_a_file_that_cannot_be_written_reports_it(tmp_path):
    with pytest.raises(InputError, match=r"cannot be written"):
        complete().save(tmp_path / "nowhere" / "left.json")
