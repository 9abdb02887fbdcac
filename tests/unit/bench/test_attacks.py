"""The table of attacks counts what the tests say, and names tests that exist."""

import xml.etree.ElementTree as ET

import pytest

from benchmarks import attacks

REPORT = """<testsuites><testsuite>
    <testcase name="a"/>
    <testcase name="b[1]"><failure message="no"/></testcase>
    <testcase name="c"><error message="no"/></testcase>
    <testcase name="d"><skipped message="no device"/></testcase>
</testsuite></testsuites>"""


def test_what_was_skipped_was_not_tried_and_what_failed_is_named():
    counts = attacks.count(ET.fromstring(REPORT))
    assert counts == {"tried": 3, "as_wanted": 1, "wrong": ["b[1]", "c"]}
    good = {"tried": 5, "as_wanted": 5, "wrong": []}
    rows = [{"what": "w", "wanted": "r", **some} for some in (counts, good)]
    said = attacks.table({"kinds": rows})
    assert "| w | 3 | r | 1 times; not: b[1], c |\n| w | 5 | r | that, each time |" in said
    assert "6 of 8 attacks" in said


@pytest.mark.parametrize("kind", attacks.KINDS, ids=lambda kind: kind.tests[0])
def test_its_tests_exist(kind):
    for name in kind.tests:
        file, _, test = name.partition("::")
        text = (attacks.CHECKOUT / file).read_text(encoding="utf-8")
        assert f"def {test or 'test_'}" in text, name


def test_a_report_is_read_back(tmp_path):
    test = tmp_path / "test_two.py"
    test.write_text("def test_good():\n    pass\ndef test_bad():\n    assert 0\n")
    report = attacks._report([str(test)], tmp_path / "report.xml")
    assert attacks.count(report) == {"tried": 2, "as_wanted": 1, "wrong": ["test_bad"]}
    with pytest.raises(attacks.InputError, match="pytest does not run the attacks"):
        attacks._report([str(tmp_path / "nothing.py")], tmp_path / "none.xml")
