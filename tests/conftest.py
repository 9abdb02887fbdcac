"""Options and rules of all tests."""

import gc
import os
import signal
import sys

import pytest

# Same as in the command line: more threads slow down small factorisations. Before numpy is
# imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Slows down emulated devices, their watchdogs and their hosts: tests run in parallel, and a virtual
# computer may pause for half a second. Before mjtactile is imported.
os.environ.setdefault("MJTACTILE_TIME_SCALE", "3")
# Without bytecode each process compiles its imports: half a second for each `mjtactile` that a test
# starts, and all tests again in each worker. Before workers start.
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

# Nearly all objects created during collection remain in use: garbage collection would take a fifth
# of its time. `pytest_collection_finish` turns it on again.
gc.disable()

pytest_plugins = ["tests.stolen", "pytester"]


def pytest_addoption(parser):
    parser.addoption(
        "--hardware",
        metavar="RIG.toml",
        help="also run the contract suite on this real rig; clear its jaws first",
    )


def seconds(item):
    """Return the approximate duration of a test, s, from its mark: `slow(60)`, `clock(10)`; else
    0."""
    marks = [item.get_closest_marker(name) for name in ("slow", "clock")]
    return max(mark.args[0] if mark and mark.args else 0 for mark in marks)


def units_of(items):
    """Group tests into the units that xdist gives to one worker.

    A unit is the tests of a group (`xdist_group`), or a single other test.
    """
    units = {}
    for item in items:
        mark = item.get_closest_marker("xdist_group")
        units.setdefault(mark.args[0] if mark else item, []).append(item)
    return list(units.values())


def seconds_of(unit):
    """Return the duration of a unit like `seconds`.

    Tests of a group without a stated duration count as 3 s each.
    """
    return seconds(unit[0]) if len(unit) == 1 else sum(seconds(item) or 3 for item in unit)


def longest_first(items, workers):
    """Return the order that keeps workers busy until the end.

    A long test that starts last delays the run. xdist gives each worker two units at the start.
    Behind the first of these comes one of the shortest units with a stated duration.
    """
    units = units_of(items)
    long = sorted((unit for unit in units if seconds_of(unit)), key=seconds_of, reverse=True)
    if len(long) > 2 * workers:
        long = [*long[:workers], *long[: -workers - 1 : -1], *long[workers:-workers]]
    units = [*long, *(unit for unit in units if not seconds_of(unit))]
    return [item for unit in units for item in unit]


def name_groups(items):
    """Append `@group` to the names of tests in a group, as xdist requires. xdist 3.8 writes it
    where pytest since 9.2 does not read it, so that each worker would create the group's
    fixtures."""
    for item in items:
        mark = item.get_closest_marker("xdist_group")
        if mark and not item.nodeid.endswith(f"@{mark.args[0]}"):
            item._id = type(item._id).parse(f"{item.nodeid}@{mark.args[0]}")
            assert item.nodeid.endswith(f"@{mark.args[0]}")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """Skip tests marked `hardware` unless a rig is given; with a rig, all tests of the contract
    suite run."""
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


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Give a tested program one processor: other tests keep the other processors busy.

    Each process imports for a second of processor time. Emulated devices take all processors.
    """
    if item.get_closest_marker("clock"):
        os.environ.pop("PYTHON_CPU_COUNT", None)
    else:
        os.environ["PYTHON_CPU_COUNT"] = "1"


def pytest_collection_finish():
    """Exclude all objects that exist before the first test from garbage collection."""
    gc.freeze()
    gc.enable()
