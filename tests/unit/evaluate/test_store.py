"""Tests that files in an evaluation's folder are kept, and that parts are joined as one evaluation
or rejected."""

import json

import pytest

from mjtactile.cli import main
from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.evaluate import store
from mjtactile.evaluate.run import merge

OPTIONS = {
    "count": 4,
    "controllers": ["gentle", "my/own.py"],
    "objects": ["egg"],
    "scenario": Scenario().to_dict(),
}


def line(episode, controller, outcome="held"):
    return {
        "episode": episode,
        "controller": controller,
        "object": "egg",
        "seed": episode,
        "outcome": outcome,
    }


def write_part(folder, part, parts, **changed):
    """Write the `part`-th of `parts` shards; `changed` are the outcomes of some of its episodes."""
    evaluation = {"options": OPTIONS | {"shard": [part, parts]}, "versions": {}, "files": {}}
    kept = store.Store(folder, evaluation, resume=False)
    for episode in range(part - 1, 4, parts):
        for controller in ("gentle", "own"):
            name = f"{controller}{episode}"
            kept.add(line(episode, controller, changed.get(name, "held")))
    return folder


@pytest.mark.parametrize("resume", [False, True])
@pytest.mark.parametrize("name", ["episodes.jsonl", "summary.json", "report.html"])
def test_results_of_unknown_files_are_kept_and_named(tmp_path, resume, name):
    text = json.dumps(line(0, "gentle")) + "\n"
    (tmp_path / name).write_text(text * 6)
    with pytest.raises(
        InputError, match=rf"--out: holds {name} without the manifest.json.* is kept"
    ):
        store.Store(tmp_path, {"options": {}}, resume=resume)
    assert (tmp_path / name).read_text() == text * 6 and len(list(tmp_path.iterdir())) == 1


def test_an_empty_folder_can_be_used(tmp_path):
    store.Store(tmp_path, {"options": {}}, resume=True)
    assert (tmp_path / "episodes.jsonl").read_text() == ""


def test_a_resumed_evaluation_may_add_episodes_but_not_remove_them(tmp_path):
    write_part(tmp_path / "a", 1, 1)
    evaluation = store.read_manifest(tmp_path / "a")
    more = evaluation | {"options": evaluation["options"] | {"count": 9}}
    assert len(store.Store(tmp_path / "a", more, resume=True).lines) == 8
    assert store.read_manifest(tmp_path / "a")["options"]["count"] == 9
    with pytest.raises(InputError, match="was started with different options: count 9, now 4"):
        store.Store(tmp_path / "a", evaluation, resume=True)


def test_a_damaged_line_does_not_affect_the_others(tmp_path, caplog):
    """Its episode counts as missing, so that a resumed evaluation runs it again."""
    write_part(tmp_path / "a", 1, 1)
    path = tmp_path / "a" / "episodes.jsonl"
    text = path.read_text().replace('{"episode": 1', "{episode: 1", 1)
    path.write_text(text)
    evaluation = store.read_manifest(tmp_path / "a")
    found = store.Store(tmp_path / "a", evaluation, resume=True).lines
    assert [(item["episode"], item["controller"]) for item in found] == [
        (k, name) for k in range(4) for name in ("gentle", "own") if (k, name) != (1, "gentle")
    ]
    assert "episodes.jsonl: 1 damaged lines are left out: line 3" in caplog.text
    assert path.with_name("episodes.jsonl.damaged").read_text() == text
    assert len(store.read_lines(tmp_path / "a")) == 7


def test_the_differing_field_is_named_with_both_values(tmp_path):
    write_part(tmp_path / "a", 1, 1)
    evaluation = store.read_manifest(tmp_path / "a")
    scenario = evaluation["options"]["scenario"] | {"seed": 7}
    other = evaluation | {"options": evaluation["options"] | {"scenario": scenario}}
    with pytest.raises(InputError, match=r"different options: scenario\.seed 0, now 7$"):
        store.Store(tmp_path / "a", other, resume=True)
    files = evaluation | {"files": {"egg.xml": "a" * 64}}
    with pytest.raises(
        InputError, match=r"different files: egg\.xml none, now aaaaaaaaaaaa\.\.\.$"
    ):
        store.Store(tmp_path / "a", files, resume=True)


def test_shards_add_up_to_the_complete_result(tmp_path):
    parts = [write_part(tmp_path / str(k), k, 3) for k in (3, 1, 2)]
    summary = merge([*parts, parts[0]], tmp_path / "all")  # one twice: the same lines
    assert summary["episodes"] == 8 and "missing" not in summary
    order = [(line["episode"], line["controller"]) for line in store.read_lines(tmp_path / "all")]
    assert order == [(k, name) for k in range(4) for name in ("gentle", "own")]


def test_a_missing_shard_is_reported_and_only_joined_when_asked(tmp_path, capsys):
    parts = [str(write_part(tmp_path / str(k), k, 3)) for k in (1, 3)]
    out = str(tmp_path / "all")
    arguments = ["evaluate", "--worst", "0", "--out", out, "--merge", *parts]
    assert main(arguments) == 2
    reported = capsys.readouterr().err
    assert "2 episodes are missing: gentle-000001, own-000001; --partial joins" in reported
    assert not (tmp_path / "all").exists()
    assert main([*arguments, "--partial", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["missing"] == ["gentle-000001", "own-000001"] and summary["episodes"] == 6
    assert "2 episodes of this evaluation are missing" in (tmp_path / "all/summary.md").read_text()


def test_two_results_that_differ_in_an_episode_are_named(tmp_path):
    first = write_part(tmp_path / "first", 2, 2)
    again = write_part(tmp_path / "again", 2, 2, own3="dropped")
    other = write_part(tmp_path / "other", 1, 2)
    with pytest.raises(
        InputError, match=rf"{again}: --merge: episode 3 of own differs from the one in {first}"
    ):
        merge([other, first, again], tmp_path / "all")
