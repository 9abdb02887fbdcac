"""Tests of the table that the stability benchmark writes into its page."""

from benchmarks.stability.run import table


def test_flags_are_counted_for_each_axis_and_failures_are_listed_with_their_checks():
    common = {"axis": "glass", "reason": "", "problems": (), "flags": ()}
    rows = [
        {**common, "outcome": "ok", "label": "1 mm", "flags": ("solver",)},
        {**common, "outcome": "flagged", "label": "2 mm", "flags": ("stretch", "speed")},
        {**common, "outcome": "flagged", "label": "3 mm", "flags": ("stretch",)},
        {**common, "outcome": "flagged", "label": "4 mm", "reason": "pushed against the glass"},
        {**common, "outcome": "FAILED", "label": "5 mm", "problems": ("NaN", "no rest")},
        {**common, "outcome": "refused", "label": "6 mm", "reason": "glass: too near"},
    ]
    lines = table({"cases": rows, "counts": {"ok": 1, "flagged": 3}}).splitlines()
    assert lines[0] == "6 cases: 1 ok, 3 flagged."
    assert lines[4] == "| glass | 1 | 3 | 1 | 1 | `stretch` 2, `speed` 1, `stop` 1 |"
    assert lines[-2:] == [
        "| glass: 5 mm | FAILED | NaN; no rest |",
        "| glass: 6 mm | refused | glass: too near |",
    ]
