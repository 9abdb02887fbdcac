"""Timing tests on a computer with shared processors. The host of a virtual computer may withhold
its processors for up to a second ("steal" in /proc/stat). Devices are silent during that time, and
a driver that reports it is right. A test marked `clock` that fails during such a time is repeated.
If it fails each time it is undecided. This is reported at the end, and never counts as passed.
Without stolen time it fails like any other test. If more than `UNDECIDED_MAX` are undecided, the
run fails: a real defect fails every time, and breaks many tests.
"""

import os
import time
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol

TRIES = 2
UNDECIDED_MAX = 20
STOLEN_MAX = 0.03  # fraction of all processors' time; smaller fractions are a few ms
_undecided: set[Path] = set()  # files with such a test: their others are tried once
_STEAL = 8  # column of /proc/stat's first line


def stolen_seconds():
    """Return the time that the host has taken from the processors since boot, s; 0 where it is not
    reported."""
    try:
        columns = Path("/proc/stat").read_text().split("\n", 1)[0].split()
    except OSError:
        return 0.0
    return float(columns[_STEAL]) / os.sysconf("SC_CLK_TCK") if len(columns) > _STEAL else 0.0


def attempt(item, nextitem):
    """Return reports of one try, and the fraction of processor time withheld during it."""
    stolen = stolen_seconds()
    start = time.monotonic()
    reports = runtestprotocol(item, nextitem=nextitem, log=False)
    return reports, (stolen_seconds() - stolen) / (time.monotonic() - start) / (os.cpu_count() or 1)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item, nextitem):
    if item.get_closest_marker("clock") is None:
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for _ in range(1 if item.path in _undecided else TRIES):
        reports, fraction = attempt(item, nextitem)
        failed = [report for report in reports if report.failed]
        if not failed or fraction < STOLEN_MAX:
            break
    else:
        _undecided.add(item.path)
        for report in failed:
            crash = getattr(report.longrepr, "reprcrash", None)
            last = (crash.message if crash else str(report.longrepr)).strip().splitlines()[0]
            report.outcome = "skipped"
            why = (
                f"undecided, {100 * fraction:.0f} % of the processors' time was taken away: {last}"
            )
            report.longrepr = (str(item.path), 0, why)
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def undecided_of(terminalreporter):
    skipped = terminalreporter.stats.get("skipped", []) if terminalreporter else []
    return [report for report in skipped if "undecided" in str(report.longrepr)]


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session):
    if (
        len(undecided_of(session.config.pluginmanager.get_plugin("terminalreporter")))
        > UNDECIDED_MAX
        and not session.exitstatus
    ):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter):
    for report in undecided_of(terminalreporter):
        terminalreporter.write_line(f"UNDECIDED {report.nodeid}: {report.longrepr[2]}")
