"""Options and rules of all tests."""

import gc
import os
import signal
import sys

import pytest

# As the command line does it: with more threads, small factorisations fight for the cores. Before
# anything imports numpy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Emulated devices, their watchdogs and whoever talks to them: tests share their computer with each
# other, and a rented one may stand still for half a second. Before anything imports mjtactile.
os.environ.setdefault("MJTACTILE_TIME_SCALE", "3")
# Where no bytecode may be written each process compiles what it imports: half a second for each
# `mjtactile` that a test starts, and all tests anew in each worker. Before there are workers.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
for number, handler in {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGQUIT: signal.SIG_DFL,
    signal.SIGHUP: signal.SIG_DFL,
}.items():
    # a shell's job in the background; tests send these to their children
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, handler)

# While modules and tests are read nearly all that is made stays: looking for what does not takes a
# fifth of the time of reading. `pytest_collection_finish` turns it on again.
gc.disable()

pytest_plugins = ["tests.stolen", "pytester"]


def pytest_addoption(parser):
    parser.addoption(
        "--hardware",
        metavar="RIG.toml",
        help="also run the contract suite on this real rig; clear its jaws first",
    )


def seconds(item):
    """About how long a test takes, if one of its marks says so: `slow(60)`, `clock(10)`."""
    marks = [item.get_closest_marker(name) for name in ("slow", "clock")]
    return max(mark.args[0] if mark and mark.args else 0 for mark in marks)


def units_of(items):
    """What xdist gives to one worker as a whole: the tests of a group (`xdist_group`), and each
    other test by itself."""
    units = {}
    for item in items:
        mark = item.get_closest_marker("xdist_group")
        units.setdefault(mark.args[0] if mark else item, []).append(item)
    return list(units.values())


def seconds_of(unit):
    """As `seconds`; tests of a group that do not say how long they take count as 3 s each."""
    return seconds(unit[0]) if len(unit) == 1 else sum(seconds(item) or 3 for item in unit)


def longest_first(items, workers):
    """The order in which workers are busy until the end: a long test that is begun last is waited
    for. xdist gives each worker two units at once, so that behind the first of these it gets one
    of the shortest that say how long they take."""
    units = units_of(items)
    long = sorted((unit for unit in units if seconds_of(unit)), key=seconds_of, reverse=True)
    if len(long) > 2 * workers:
        long = [*long[:workers], *long[: -workers - 1 : -1], *long[workers:-workers]]
    units = [*long, *(unit for unit in units if not seconds_of(unit))]
    return [item for unit in units for item in unit]


def name_groups(items):
    """xdist knows groups by `@group` at the end of a test's name. Its 3.8 writes that where
    pytest since 9.2 does not read it, and then a group's fixtures are made once a worker."""
    for item in items:
        mark = item.get_closest_marker("xdist_group")
        if mark and not item.nodeid.endswith(f"@{mark.args[0]}"):
            item._id = type(item._id).parse(f"{item.nodeid}@{mark.args[0]}")
            assert item.nodeid.endswith(f"@{mark.args[0]}")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """Tests marked `hardware` run only when a rig was named; with one, nothing else of the contract
    suite is left out."""
    if workers := int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "0")):
        items[:] = longest_first(items, workers)
        if config.getvalue("loadgroup"):
            name_groups(items)
    if config.getoption("--hardware"):
        return
    skip = pytest.mark.skip(reason="needs a real rig: pytest --hardware RIG.toml")
    for item in items:
        if "hardware" in item.keywords:
            item.add_marker(skip)


def pytest_collection_finish():
    """What there is before the first test stays until the last, and is never looked through for
    garbage."""
    gc.freeze()
    gc.enable()
