"""Tests that the table of injected faults names existing tests."""

import xml.etree.ElementTree as ET

import pytest

from benchmarks import fault_injection

REPORT = """<testsuites><testsuite>
    <testcase name="a"/>
    <testcase name="b[1]"><failure message="no"/></testcase>
    <testcase name="c"><error message="no"/></testcase>
    <testcase name="d"><skipped message="no device"/></testcase>
</testsuite></testsuites>"""


def test_skipped_cases_are_not_run_and_failed_cases_are_named():
    counts = fault_injection.count(ET.fromstring(REPORT))
    assert counts == {"cases": 3, "passed": 1, "wrong": ["b[1]", "c"]}
    good = {"cases": 5, "passed": 5, "wrong": []}
    rows = [{"fault": "w", "required": "r", **some} for some in (counts, good)]
    reported = fault_injection.table({"kinds": rows})
    assert "| w | 3 (1 met; not: b[1], c) | r |\n| w | 5 | r |" in reported
    assert "6 of 8 cases meet the requirement" in reported


@pytest.mark.parametrize("kind", fault_injection.KINDS, ids=lambda kind: kind.tests[0])
def test_its_tests_exist(kind):
    for name in kind.tests:
        file, _, test = name.partition("::")
        text = (fault_injection.CHECKOUT / file).read_text(encoding="utf-8")
        assert f"def {test or 'test_'}" in text, name


def test_a_report_is_read_back(tmp_path):
    test = tmp_path / "test_two.py"
    test.write_text("def test_good():\n    pass\ndef test_bad():\n    assert 0\n")
    report = fault_injection._report([str(test)], tmp_path / "report.xml")
    assert fault_injection.count(report) == {"cases": 2, "passed": 1, "wrong": ["test_bad"]}
    with pytest.raises(fault_injection.InputError, match="pytest does not run the attacks"):
        fault_injection._report([str(tmp_path / "nothing.py")], tmp_path / "none.xml")
