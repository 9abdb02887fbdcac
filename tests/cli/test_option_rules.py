"""Tests of options without an effect, which are refused."""

import importlib

import pytest

from mjtactile.cli import build_parser
from mjtactile.commands import COMMANDS, option_rules
from mjtactile.commands.option_rules import _single

EXPORT = ("export", "run", "--out", "data")
RECORD = ("record", "--out", "run")
REFUSED = [
    ((*EXPORT, "--format", "mcap", "--crf", 20), "--crf"),
    ((*EXPORT, "--format", "rerun", "--images", "png"), "--images"),
    ((*EXPORT, "--format", "rosbag2", "--task", "hold it"), "--task"),
    ((*EXPORT, "--format", "lerobot", "--images", "png", "--crf", 20), "--crf"),
    (("studio", "--native", "--port", 8080), "--port"),
    (("studio", "--native", "--no-browser"), "--no-browser"),
    (("studio", "--native", "--no-wait"), "--no-wait"),
    (("studio", "--rig", "replay:run", "--controller", "gentle"), "--controller"),
    (("grasp", "--rig", "replay:run", "--object", "vial"), "--object"),
    (("studio", "--rig", "replay:run", "--effects=-images"), "--effects"),
    (("probe", "--source", "run", "--object", "egg"), "--object"),
    (("probe", "--source", "run", "--seed", 3), "--seed"),
    (("probe", "--source", "run", "--frames", "none"), "--frames"),
    (("explore", "--input", "run", "--resume"), "--input"),
    (("explore", "--input", "run", "--touches", 3), "--touches"),
    (("explore", "--input", "run", "--setup", "stage"), "--setup"),
    (("explore", "--input", "run", "--force-N", 0.5), "--force-N"),
    (("explore", "--input", "run", "--rotation-deg", 1, "--rotation-deg", 2), "--rotation-deg"),
    ((*RECORD, "--rig", "stage", "--indenter", "sphere:8"), "--indenter"),
    ((*RECORD, "--rig", "stage", "--position-mm", "1,2"), "--position-mm"),
    ((*RECORD, "--rig", "stage", "--load-cell"), "--load-cell"),
    ((*RECORD, "--rig", "sim", "--protocol", "press", "--load-cell"), "--load-cell"),
    ((*RECORD, "--rig", "sim", "--as-built", "odd.toml"), "--as-built"),
    ((*RECORD, "--rig", "stage", "--object", "egg"), "--object"),
    ((*RECORD, "--rig", "stage", "--protocol", "press", "--finger", "right"), "--finger"),
    ((*RECORD, "--rig", "stage", "--time-scale", 2), "--time-scale"),
    (("grasp", "--video", "a.mp4", "--frames", "none"), "--video"),
    (("grasp", "--video", "a.mp4", "--effects=+shadows, -images"), "--video"),
]


@pytest.mark.parametrize(("words", "option"), REFUSED)
def test_an_option_without_an_effect_is_refused(command, tmp_path, words, option):
    done = command(*words)
    assert done.returncode == 2
    assert done.stderr.startswith(f"mjtactile: {option}: ")
    assert done.stderr.count("\n") == 1
    assert not [*tmp_path.iterdir()]


ACCEPTED = [
    (*EXPORT, "--format", "lerobot", "--images", "none", "--task", "hold it"),
    (*EXPORT, "--format", "mcap", "--images", "video"),  # the default
    ("studio", "--web", "--port", "8080", "--no-browser", "--seed", "1"),
    ("probe", "--source", "run", "--sensor", "dense", "--out", "result"),
    ("explore", "--input", "run", "--rotation-deg", "90", "--sensor", "dense"),
    (*RECORD, "--rig", "stage", "--protocol", "press", "--load-cell", "--position-mm", "1,2"),
    (*RECORD, "--rig", "sim", "--protocol", "press", "--finger", "right", "--object", "egg"),
    ("grasp", "--video", "a.mp4", "--effects", "-latency", "--frames", "every:2"),
]


@pytest.mark.parametrize("words", ACCEPTED)
def test_an_option_with_an_effect_is_accepted(words):
    options = build_parser(words[0]).parse_args(words)
    options.check_rules(options)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_rule_names_options_of_its_command(name):
    module = importlib.import_module(f"mjtactile.commands.{name.replace('-', '_')}")
    names = {option for item in _single(module.ARGUMENTS) for option in item.names}
    for rule in getattr(module, "RULES", ()):
        assert isinstance(rule, option_rules.Rule)
        assert {*rule.options} <= names
