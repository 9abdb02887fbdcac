"""Options and rules of all tests."""

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


pytest_plugins = ["tests.stolen", "pytester"]


def pytest_addoption(parser):
    parser.addoption(
        "--hardware",
        metavar="RIG.toml",
        help="also run the contract suite on this real rig; clear its jaws first",
    )


def pytest_collection_modifyitems(config, items):
    """Tests marked `hardware` run only when a rig was named; with one, nothing else of the contract
    suite is left out."""
    if config.getoption("--hardware"):
        return
    skip = pytest.mark.skip(reason="needs a real rig: pytest --hardware RIG.toml")
    for item in items:
        if "hardware" in item.keywords:
            item.add_marker(skip)
