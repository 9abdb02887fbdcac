"""Tests of flags: their time, their JSON, and the registry with its page."""

import json
import math
import pickle
from pathlib import Path

import pytest

from mjtactile.core import flags
from mjtactile.core.flags import Cadence, Flag, FlagTracker, merge_flags, read_flags
from mjtactile.recording.files import to_json


def test_a_flag_of_the_first_moments_of_a_hold_has_its_time():
    """A hold of 8 s, checked every 0.1 s; an edge is in contact from 0.1 to 0.4 s: 0.3 of 8 s."""
    tracker = FlagTracker(0.0)
    for k in range(1, 81):
        up = {"sharp_edge": f"reason {k}"} if 1 <= k < 4 else {}
        tracker.update(0.1 * k, up, flags.SIMULATION)
    edge = tracker.flags()["sharp_edge"]
    assert edge == "reason 1"
    assert (edge.first, edge.last) == (pytest.approx(0.1), pytest.approx(0.4))
    assert edge.fraction == pytest.approx(0.3 / 8)
    assert edge.when == "0.10 to 0.40 s, 4 % of the time"


def test_a_check_clears_the_flags_of_its_own_cadence_only():
    tracker = FlagTracker(0.0, {"mesh": "coarse"})
    tracker.update(1.0, {"stretch": "large", "sharp_edge": "an edge"}, flags.SIMULATION)
    tracker.update(2.0, {}, {Cadence.CONTACT})
    found = tracker.flags(4.0)
    assert [found[kind].last for kind in ("mesh", "stretch", "sharp_edge")] == [4.0, 4.0, 2.0]
    assert [found[kind].fraction for kind in ("mesh", "stretch", "sharp_edge")] == [1.0, 0.75, 0.25]


def test_only_a_reason_with_an_amount_is_updated():
    tracker = FlagTracker(0.0)
    tracker.update(1.0, {"frame_contact": "1 N", "sharp_edge": "an edge"})
    tracker.update(2.0, {"frame_contact": "3 N", "sharp_edge": "another"})
    assert tracker.flags() == {"frame_contact": "3 N", "sharp_edge": "an edge"}


def test_a_kind_without_an_entry_is_refused():
    with pytest.raises(KeyError, match="new_kind"):
        FlagTracker(0.0).update(1.0, {"new_kind": "no entry in FLAGS"})


def test_json_and_pickle_keep_the_time():
    flag = Flag("an edge presses", 0.5, 2.0, 0.25)
    text = json.dumps(to_json({"sharp_edge": flag}))
    for read in (read_flags(json.loads(text))["sharp_edge"], pickle.loads(pickle.dumps(flag))):
        assert read.to_dict() == flag.to_dict()


def test_flags_of_old_files_have_a_new_name_and_no_time():
    found = read_flags({"edge": "an edge presses"})
    assert found == {"sharp_edge": "an edge presses"}
    assert math.isnan(found["sharp_edge"].fraction) and found["sharp_edge"].when == ""


def test_merged_flags_have_the_first_reason_and_the_complete_time():
    one = {"speed": Flag("first", 1.0, 2.0, 0.1)}
    other = {"speed": Flag("second", 0.5, 1.5, 0.3), "hull": Flag("hollow")}
    merged = merge_flags((one, other))
    assert list(merged) == ["speed", "hull"]
    assert merged["speed"].to_dict() == Flag("first", 0.5, 2.0, 0.3).to_dict()


def test_the_page_has_the_registry():
    page = (Path(__file__).resolve().parents[3] / "docs/reference/status_and_flags.md").read_text()
    written = page.partition("<!-- bench:flags-page -->\n")[2].partition("<!-- /bench -->")[0]
    # else: mjtactile bench flags-page --readme
    assert written == flags.table()
