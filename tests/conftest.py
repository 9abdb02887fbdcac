"""Options and rules of all tests."""

import gc
import os
import signal

import pytest

# As the command line does it: with more threads, small factorisations fight for the cores. Before
# anything imports numpy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Emulated devices, their watchdogs and whoever talks to them: tests share their computer with each
# other, and a rented one may stand still for half a second. Before anything imports mjtactile.
os.environ.setdefault("MJTACTILE_SLOW", "3")
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


def longest_first(items, workers):
    """The order in which workers are busy until the end: a long test that is begun last is waited
    for. xdist gives each worker two tests at once, so that behind the first of these it gets one
    of the shortest that say how long they take."""
    long = sorted((item for item in items if seconds(item)), key=seconds, reverse=True)
    if len(long) > 2 * workers:
        long = [*long[:workers], *long[: -workers - 1 : -1], *long[workers:-workers]]
    return [*long, *(item for item in items if not seconds(item))]


def pytest_collection_modifyitems(config, items):
    """Tests marked `hardware` run only when a rig was named; with one, nothing else of the contract
    suite is left out."""
    if workers := int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "0")):
        items[:] = longest_first(items, workers)
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
