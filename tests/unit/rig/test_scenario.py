"""Tests of a scenario: its file, its result, and the actual sensors of each finger."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

import mjtactile
from mjtactile.cli import main
from mjtactile.core import resources
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.recording.files import write_json
from mjtactile.recording.writer import Recorder
from mjtactile.rig import registry
from mjtactile.rig.scenario import load_scenario, resolve_scenario
from tests.fake_run import fake_cycle

OTHER = Scenario(
    object="random:7",
    controller="gentle",
    rig="sim_three_finger",
    sensor="paper16",
    sensors={"finger1": "dense"},
    effects="+bending,-friction",
    accuracy="0.02N",
    randomization="default",
    seed=12345,
    time_limit=7.5,
)


def test_the_shipped_file_is_the_default_with_every_field(tmp_path):
    """The shipped file equals the default and shows every field: fields omitted from a copy have
    the value in the file."""
    shipped = resources.find("lift", "models/scenarios", ".toml")
    assert load_scenario(shipped) == Scenario()
    keys = {line.partition(" =")[0] for line in shipped.read_text().splitlines() if " = " in line}
    assert keys >= set(Scenario().to_dict()) - {"sensors"}
    (tmp_path / "empty.toml").write_text("")
    assert load_scenario(tmp_path / "empty.toml") == Scenario()


@pytest.mark.parametrize("scenario", [Scenario(), OTHER, replace(OTHER, time_limit=float("inf"))])
def test_a_result_gives_the_same_scenario_again(tmp_path, scenario):
    write_json(tmp_path / "summary.json", {"outcome": "held", "scenario": scenario.to_dict()})
    assert load_scenario(tmp_path / "summary.json") == scenario


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ('objekt = "egg"', ["objekt", "did you mean 'object'"]),
        ('object = "eg"', ["object", "'eg' is unknown", "egg"]),
        ('sensor = "nowhere.toml"', ["sensor", "no such file: 'nowhere.toml'", "dense"]),
        ('controller = "strong"', ["controller", "'strong' is unknown", "gentle"]),
        ('randomization = "wild"', ["randomization", "'wild' is unknown", "none"]),
        ('task = "juggle"', ["task", "'juggle' is unknown", "lift"]),
        ("seed = -1", ["seed", "-1 is outside 0"]),
        ("seed = 1.5", ["seed", "1.5 is not a whole number"]),
        ("time_limit_s = 0", ["time_limit_s", "0 is outside 0.1"]),
        ('[sensors]\nleft = "dens"', ["sensors.left", "'dens' is unknown", "dense"]),
        ("sensors = 3", ["sensors", "not a section"]),
        ("object = 3", ["object", "3 is not text"]),
    ],
)
def test_an_error_is_one_line_with_file_field_value_and_choices(tmp_path, text, parts):
    path = tmp_path / "mine.toml"
    path.write_text(text + "\n")
    with pytest.raises(InputError) as caught:
        load_scenario(path)
    reported = str(caught.value)
    assert "\n" not in reported and all(part in reported for part in ["mine.toml", *parts]), (
        reported
    )


def test_a_json_without_a_scenario_and_another_suffix(tmp_path):
    (tmp_path / "other.json").write_text("[]")
    with pytest.raises(InputError, match="contains no scenario"):
        load_scenario(tmp_path / "other.json")
    with pytest.raises(InputError, match=r"FILE.toml, RUN/summary.json"):
        load_scenario(tmp_path / "other.txt")


def test_files_next_to_the_scenario_have_priority(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    for folder in (tmp_path, tmp_path / "here"):
        (folder / "mine.py").write_text("")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "here" / "a.toml").write_text('controller = "mine.py"\n')
    assert load_scenario("here/a.toml").controller == "here/mine.py"
    (tmp_path / "here" / "mine.py").unlink()
    assert load_scenario("here/a.toml").controller == "mine.py"


def rig_with(path, **sensors):
    """Return the shipped simulated rig whose fingers name these sensors."""
    source = resources.find("sim", "models/rigs", ".toml")
    text = source.read_text().replace('model = "', f'model = "{source.parent}/')
    for finger, sensor in sensors.items():
        text = text.replace(f'name = "{finger}"', f'name = "{finger}"\nsensor = "{sensor}"')
    path.write_text(text)
    return str(path)


def test_a_scenario_has_the_sensors_that_the_rigs_fingers_really_have(tmp_path):
    same = resolve_scenario(
        Scenario(rig=rig_with(tmp_path / "same.toml", left="paper16", right="paper16"))
    )
    assert (same.sensor, same.sensors) == ("paper16", {})
    one = resolve_scenario(Scenario(rig=rig_with(tmp_path / "one.toml", left="paper16")))
    assert (one.sensor, one.sensors) == ("dense", {"left": "paper16"})
    assert one.names()["sensor"] == "dense, paper16"
    assert resolve_scenario(one) == one and resolve_scenario(same) == same
    # a finger's sensor in a scenario overrides the rig file
    rig = mjtactile.build_rig(replace(one, sensors={"left": "dense", "right": "paper16"}))
    rig.close()
    assert [finger.design.name for finger in rig.fingers] == ["dense", "paper16"]
    with pytest.raises(InputError, match=r"sim has no finger 'thumb' .*left, right"):
        resolve_scenario(replace(one, sensors={"thumb": "dense"}))


@pytest.mark.parametrize(("rig", "finger"), [("sim", "left"), ("sim_three_finger", "first")])
@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        ("/etc/passwd", "/etc/passwd: sensor: does not end in .toml"),
        ("dens", "dens: unknown sensor"),
    ],
)
def test_a_sensor_that_is_not_built_is_refused(rig, finger, sensor, message):
    """An unknown name is never reported as a result: with each rig the sensor is read."""
    with pytest.raises(InputError, match=message):
        mjtactile.build_rig(Scenario(rig=rig, sensors={finger: sensor}))


def test_the_rig_sim_has_the_sensors_of_the_scenario(tmp_path):
    (tmp_path / "a.toml").write_text('[sensors]\nleft = "paper16"\n')
    rig = mjtactile.build_rig(load_scenario(tmp_path / "a.toml"))
    rig.close()
    assert [finger.design.name for finger in rig.fingers] == ["paper16", "dense"]
    with pytest.raises(InputError, match=r"sim has no finger 'thumb' .*left, right"):
        mjtactile.build_rig(Scenario(sensors={"thumb": "dense"}))
    (tmp_path / "a.toml").write_text('[sensors]\nleft = "/etc/passwd"\n')
    with pytest.raises(InputError, match=r"sensors.left: '/etc/passwd' does not end in .toml"):
        load_scenario(tmp_path / "a.toml")


def test_a_backend_that_ignores_a_fingers_sensor_is_refused(monkeypatch):
    """A rig of another package that builds its own sensor would otherwise be reported wrongly."""
    own = mjtactile.build_rig("sim")
    closed = []
    rig = replace(own, close=lambda: closed.append(True))
    monkeypatch.setattr(registry, "_entry_points", lambda group: {"theirs": None})
    monkeypatch.setattr(registry, "load_backend", lambda group, name: lambda request: rig)
    assert mjtactile.build_rig(Scenario(rig="theirs", sensors={"left": "dense"})).name == rig.name
    with pytest.raises(InputError, match=r"sensors.left: the rig 'theirs' has the sensor 'dense'"):
        mjtactile.build_rig(Scenario(rig="theirs", sensors={"left": "paper16"}))
    assert closed == [True]
    own.close()


def recorded(folder, sensor, **fields):
    scenario = Scenario(sensor=sensor, **fields)
    with Recorder(folder, scenario.header()) as recorder:
        recorder.add(fake_cycle(0, 1))
    return f"replay:{folder}"


def test_a_recording_is_replayed_with_the_sensor_that_it_contains(tmp_path, caplog):
    """The recorded text is used, and another sensor than the recorded one is refused."""
    path = tmp_path / "mine.toml"
    text = resources.find("dense", "models/sensors", ".toml").read_text()
    path.write_text(text.replace("\nthickness_mm = 0.3 ", "\nthickness_mm = 0.36 "))
    own = load_sensor(path)
    rig = recorded(tmp_path / "run", str(path))
    assert resolve_scenario(Scenario(rig=rig)).sensor == own and not caplog.text
    path.write_text(text.replace("\nthickness_mm = 0.3 ", "\nthickness_mm = 0.6 "))  # edited
    assert load_sensor(path).membrane != own.membrane
    replayed = resolve_scenario(Scenario(rig=rig))
    assert replayed.sensor == own and "mine.toml' has changed since" in caplog.text
    assert resolve_scenario(replayed) == replayed
    with pytest.raises(InputError, match="recorded with other values of 'mine', not with"):
        resolve_scenario(replace(replayed, sensor=str(path)))
    path.unlink()
    assert resolve_scenario(Scenario(rig=rig)).sensor == own
    with pytest.raises(InputError, match=r"--sensor: finger 'left' was recorded with 'mine', not"):
        resolve_scenario(replace(replayed, sensor="round30"))
    # the default is another, too, if it is given
    with pytest.raises(InputError, match="was recorded with 'mine', not with the present 'dense'"):
        resolve_scenario(Scenario(rig=rig), given=("sensor",))


def test_a_sensor_that_no_file_has_is_recorded_by_its_values(tmp_path):
    dense = load_sensor("dense")
    thick = replace(dense, membrane=replace(dense.membrane, thickness=0.36e-3))
    found = resolve_scenario(Scenario(rig=recorded(tmp_path, thick))).sensor
    assert found == thick
    assert "--sensor" not in Scenario(sensor=thick).command()


def test_a_replay_has_the_names_of_its_recording(tmp_path):
    rig = recorded(
        tmp_path, "dense", object="random:12", controller="adaptive", task="pour", seed=4
    )
    replayed = resolve_scenario(Scenario(rig=rig))
    assert replayed.names() == {
        "object": "random:12",
        "sensor": "dense",
        "controller": "adaptive",
        "seed": 4,
    }
    assert replayed.task == "pour"
    other = resolve_scenario(Scenario(rig=rig, controller="slip_aware"))
    assert (other.controller, other.object) == ("slip_aware", "random:12")


def test_a_recording_without_its_sensors_text_uses_the_file_with_a_warning(tmp_path, caplog):
    with Recorder(tmp_path / "old", {"sensor": "nowhere"}) as recorder:
        recorder.add(fake_cycle(0, 1))
    with pytest.raises(InputError, match=r"does not contain the text of its sensor: .*nowhere"):
        resolve_scenario(Scenario(rig=f"replay:{tmp_path / 'old'}"))
    with Recorder(tmp_path / "none", {}) as recorder:
        recorder.add(fake_cycle(0, 1))
    assert resolve_scenario(Scenario(rig=f"replay:{tmp_path / 'none'}")).design().name == "dense"
    assert "the present file 'dense' is used" in caplog.text


QUICK = """
from dataclasses import replace
from pathlib import Path

def step(observation):
    command = observation.command
    count = command.memory.get("count", 0) + 1
    return replace(command, phase="done" if count > 3 else "approach", memory={"count": count})
"""


def test_a_run_states_its_fingers_own_sensors_and_is_estimated_again_with_them(
    tmp_path, monkeypatch, capsys
):
    """The summary of such a recording once failed: the pipeline of another sensor found few of its
    markers."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quick.py").write_text(QUICK)
    rig = rig_with(tmp_path / "rig.toml", left="paper16")
    arguments = ["--rig", rig, "--controller", "quick.py", "--out", "run", "--json"]
    code = main(["grasp", *arguments])
    summary = json.loads(capsys.readouterr().out)
    assert code == 1  # read only
    assert summary["sensor"] == "dense, paper16"
    assert main(["summary", "run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["re_estimate"]
    recording = mjtactile.load_recording("run")
    assert recording.header["scenario"] == summary["scenario"]
    # and the same run again, from its result
    arguments = ["--controller", "quick.py", "--out", "again", "--json"]
    assert main(["grasp", "--scenario", "run/summary.json", *arguments]) == 1
    again = json.loads(capsys.readouterr().out)
    assert again["scenario"] == summary["scenario"]
    first = recording.column("force_normal")
    assert first.tolist() == mjtactile.load_recording("again").column("force_normal").tolist()


def test_options_override_the_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quick.py").write_text(QUICK)
    (tmp_path / "mine.toml").write_text('object = "vial"\ncontroller = "quick.py"\nseed = 3\n')
    arguments = ["--sensor", "paper16", "--seed", "4", "--out", "run", "--json"]
    arguments += ["--controller", "quick.py"]
    assert main(["grasp", "--scenario", "mine.toml", *arguments]) == 1
    reported = json.loads(capsys.readouterr().out)["scenario"]
    assert (reported["object"], reported["seed"], reported["sensor"]) == ("vial", 4, "paper16")


PROGRAM = (
    "from pathlib import Path\nPath('it_ran').touch()\ndef step(observation):\n    raise OSError\n"
)


def name_a_program(how):
    """Write data that name the controller file "theirs.py"; return the options that read them."""
    scenario = Scenario(controller="theirs.py")
    if how == "result":
        write_json(Path("summary.json"), {"scenario": scenario.to_dict()})
        return ["--scenario", "summary.json"]
    if how == "recording":
        with Recorder(Path("theirs"), scenario.header()) as recorder:
            recorder.add(fake_cycle(0, 1))
        return ["--rig", "replay:theirs"]
    place = "theirs.py" if how == "scenario" else str(Path("theirs.py").absolute())
    Path("theirs.toml").write_text(f'controller = "{place}"\n')
    return ["--scenario", "theirs.toml"]


@pytest.mark.parametrize("how", ["result", "scenario", "absolute", "recording"])
@pytest.mark.parametrize("command", ["grasp", "studio", "probe", "evaluate"])
def test_a_program_named_only_in_data_is_not_run(tmp_path, monkeypatch, capsys, how, command):
    """A scenario of another person may name any file: without --controller it is refused."""
    if command == "evaluate" and how == "recording":
        pytest.skip("evaluate does not take recordings")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "theirs.py").write_text(PROGRAM)
    assert main([command, *name_a_program(how)]) == 2
    error = capsys.readouterr().err
    assert (
        "--controller: the controller" in error
        and "--controller theirs.py" in error
        or (how == "absolute" and f"--controller {tmp_path}/theirs.py" in error)
    )
    assert not (tmp_path / "it_ran").exists()


def test_merged_results_do_not_run_their_own_program(tmp_path, monkeypatch, capsys):
    """Results of another person name a program: their report is written, without its images."""
    monkeypatch.chdir(tmp_path)
    Path("theirs.py").write_text("from pathlib import Path\n" + QUICK)
    arguments = ["--episodes", "1", "--objects", "egg", "--effects=-images,-mesh,-pipeline"]
    names = ["--controller", "theirs.py", "--workers", "1", "--worst", "0"]
    assert main(["evaluate", *arguments, *names, "--out", "first"]) == 0
    Path("theirs.py").write_text("from pathlib import Path\nPath('it_ran').touch()\n" + QUICK)
    assert main(["evaluate", "--merge", "first", "--out", "second"]) == 0
    assert "'theirs.py' is not run" in capsys.readouterr().err
    assert not Path("it_ran").exists() and Path("second/report.html").is_file()
    assert main(["evaluate", "--merge", "first", "--out", "third", *names[:2]]) == 0
    assert Path("it_ran").exists()
