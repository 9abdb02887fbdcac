"""`mjtactile record --rig stage`, then `mjtactile fit`: the fitted sensor file loads, and lists the
parameters that could not be identified."""

import json
import shutil

import pytest

from mjtactile.cli import main
from mjtactile.core.design import load_sensor
from mjtactile.recording.reader import load_recording
from mjtactile.recording.stage_protocol import protocol_indenter


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Provide half a second without contact of a sensor that is 20 % stiffer than its file."""
    folder = tmp_path_factory.mktemp("stage")
    text = (load := load_sensor("paper16")) and open_text("paper16")
    (folder / "odd.toml").write_text(text.replace("young_MPa = 1.0", "young_MPa = 1.2"))
    assert load.membrane.young == 1e6
    assert (
        main(
            [
                "record",
                "--rig",
                "stage",
                "--sensor",
                "paper16",
                "--as-built",
                str(folder / "odd.toml"),
                "--seconds",
                "0.5",
                "--out",
                str(folder / "still"),
            ]
        )
        == 0
    )
    return folder / "still"


def open_text(name):
    from mjtactile.core import resources

    return resources.find(name, "models/sensors", ".toml").read_text()


def test_a_recording_does_not_contain_the_as_built_sensor(recording):
    found = load_recording(recording)
    assert (
        found.complete
        and found.header["design"] == "paper16"
        and "1.2" not in found.header["files"]["sensor"]["text"]
    )
    assert found.column("gauge_pressure").mean() == pytest.approx(1000, abs=10)


def test_a_fit_writes_a_sensor_file_and_its_report(recording, tmp_path, capsys):
    out = tmp_path / "mine.toml"
    assert (
        main(
            [
                "fit",
                "--recording",
                str(recording),
                "--fix",
                "membrane.pre_stretch=1.05",
                "--out",
                str(out),
                "--json",
            ]
        )
        == 0
    )
    found = {n["field"]: n for n in json.loads(capsys.readouterr().out)["numbers"]}
    # height known to 0.5 % of 2 mm (its sensor's lens): the modulus to about twice that
    assert load_sensor(out).membrane.young == pytest.approx(1.2e6, rel=0.03)
    assert (
        found["membrane.young_MPa"]["state"] == "fitted"
        and found["membrane.pre_stretch"]["state"] == "known"
    )
    assert found["membrane.friction"]["state"] == "not in these recordings"
    assert "drag a loaded indenter" in out.read_text()
    assert {path.name for path in tmp_path.iterdir()} >= {
        "mine.toml",
        "mine.fit.json",
        "mine.fit.txt",
    }


def test_bad_input_is_one_line(recording, tmp_path, capsys):
    for words, message in [
        (["--fix", "membrane.colour=3"], "is not a field"),
        (["--fix", "young"], "FIELD=NUMBER"),
        (["--finger", "thumb"], "thumb"),
    ]:
        assert (
            main(["fit", "--recording", str(recording), "--out", str(tmp_path / "x.toml"), *words])
            == 2
        )
        assert message in capsys.readouterr().err


def test_an_indenter_wider_than_the_frame_is_refused(recording, tmp_path, capsys):
    # 36 mm over an opening of 40 x 30 mm: it presses on the frame
    wide = tmp_path / "wide"
    shutil.copytree(recording, wide)
    log = wide / "recording" / "log.jsonl"
    moves = [{"time_s": 0.1, "depth_mm": 2}]
    stage = {"indenter": "sphere:18", "at_mm": [0, 0], "finger": "left", "moves": moves}
    lines = log.read_text().splitlines()
    lines.insert(-1, json.dumps({"kind": "note", "stage": stage}))
    log.write_text("\n".join(lines) + "\n")
    assert main(["fit", "--recording", str(wide), "--out", str(tmp_path / "x.toml")]) == 2
    reported = capsys.readouterr().err
    assert (
        reported.count("\n") == 1 and "sphere:18 is 36 mm wide" in reported and "30 mm" in reported
    )
    assert "sphere:8" in reported  # the recommended recording


def test_the_indenter_of_a_protocol_follows_the_frame():
    assert protocol_indenter("press", 30e-3) == "sphere:8"
    assert protocol_indenter("tap", 30e-3) == "sphere:13.5"
    for side in (8e-3, 12e-3, 24e-3, 60e-3):
        for protocol in ("press", "drag", "tap", "still", "my.csv"):
            radius = float(protocol_indenter(protocol, side).removeprefix("sphere:"))
            assert 2e-3 * radius < side
