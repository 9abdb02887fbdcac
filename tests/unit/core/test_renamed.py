"""Names from before 0.2.0 are refused with the new name, and translated in recordings."""

import pytest

from mjtactile.cli import main
from mjtactile.core import renamed
from mjtactile.core.errors import InputError
from mjtactile.core.toml import Section


def test_old_and_new_names_are_distinct():
    """Seeds are hashes of old keys, so that the table must be invertible."""
    assert len(set(renamed.KEYS.values())) == len(renamed.KEYS)
    assert not set(renamed.KEYS.values()) & set(renamed.KEYS)
    for old, new in renamed.KEYS.items():
        assert renamed.old_key(new) == old
    assert renamed.old_key("mass_g") == "mass_g"
    assert renamed.old_keys({"gas": {"polytropic_exponent": 1.0}}) == {"gas": {"heat_ratio": 1.0}}


def test_an_old_file_key_is_refused_with_its_new_name():
    section = Section({"told": {}}, "", "my.toml")
    section.number("time_limit_s", 0, 1, default=None)
    with pytest.raises(InputError, match="`told` is now `goal`"):
        section.done()
    with pytest.raises(InputError, match="`rim_mm` is now `wall_mm`"):
        Section({"rim_mm": 3.0}, "frame", "my.toml").number("wall_mm", 0, 10)


def test_an_old_value_is_read_with_a_warning(caplog):
    section = Section({"surface": "pane"}, "fiducials", "my.toml")
    assert section.text("surface", ("rim", "glass")) == "glass"
    assert caplog.messages == ["my.toml: fiducials.surface: 'pane' is now 'glass'"]
    assert renamed.old_keys({"surface": "glass"}) == {"surface": "pane"}  # fingerprints stay


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["grasp", "--vary", "default"], "`--vary` is now `--randomization`"),
        (["evaluate", "--against", "v1"], "`--against` is now `--suite`"),
        (["bench", "speed", "--against", "."], "`--against` is now `--baseline`"),
        (["bench", "bars"], "`bars` is now `uncertainty`"),
        (["shadow", "runs/egg"], "`shadow` is now `compare-sim`"),
        (["effects", "--effects=-sheet"], "`sheet` is now `mesh`"),
    ],
)
def test_an_old_option_is_refused_with_its_new_name(capsys, words, text):
    assert main(words) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert text in line


def test_an_error_of_an_invalid_value_names_no_old_name(capsys):
    arguments = [
        "press",
        "--indenter",
        "sphere:4",
        "--position-mm",
        "3",
    ]  # `numbers` was a benchmark
    assert main(arguments) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "'3' is not a pair of numbers X,Y" in line
    assert " is now " not in line


def test_a_line_of_an_old_recording_is_translated():
    row = {
        "kind": "cycle",
        "pressure_gauge": [1000.0],
        "status": ["no shape", "the markers fit no shape"],
        "status_code": ["air moves", "ok"],
        "shape_kind": ["face", "none"],
        "force_normal": [0.5],
    }
    assert renamed.current_row(row) == {
        "kind": "cycle",
        "gauge_pressure": [1000.0],
        "status": ["fit failed", "the markers fit no shape"],
        "status_code": ["pressure changing", "ok"],
        "shape_kind": ["flat", "none"],
        "force_normal": [0.5],
    }
    header = renamed.current_row({"kind": "start", "scenario": {"vary": "none", "seed": 3}})
    assert header["scenario"] == {"randomization": "none", "seed": 3}
