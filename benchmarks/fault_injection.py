"""`mjtactile bench fault-injection`: everything bad that the tests do to this project, counted by
what must come of it.

An attack is one case of a test: a file with one thing wrong, a byte changed on a wire, a signal
while something is held. The tests judge it; here they are run again and counted, so that the table
says what was tried and nothing that was not.
"""

from __future__ import annotations

import json
import platform
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.accuracy.run import stamp
from mjtactile.core.errors import InputError
from mjtactile.recording.files import write_json
from mjtactile.runtime.progress import Progress

CHECKOUT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Kind:
    """Attacks of one kind: what is tried, what must come of it, and the tests that judge it (as
    pytest names them). `quick` ones need no emulated rig."""

    what: str
    wanted: str
    tests: Sequence[str]
    quick: bool = True


KINDS = (
    Kind(
        "object, sensor, rig and controller files with one thing wrong; bad arguments",
        "refused in one line, exit code 2, nothing left behind",
        (
            "tests/cli/test_bad_input.py",
            "tests/cli/test_calibration_files.py",
            "tests/unit/rig/test_rigfile.py",
            "tests/unit/core/test_toml.py",
            "tests/physics/test_robots.py::test_what_cannot_be_built_is_refused_in_one_line",
        ),
    ),
    Kind(
        "recordings cut off, damaged, foreign; full disks, no descriptors, removed folders",
        "refused with line and column, or whole up to the damage",
        (
            "tests/unit/recording/test_damaged.py",
            "tests/unit/recording/test_recording.py",
            "tests/unit/evaluate/test_pool.py",
        ),
    ),
    Kind(
        "controllers that raise, hang, exit, make commands past their checks, ask for NaN, too "
        "much or air that a rig has not, end with the hand up, do not import",
        "the hand retreats, then one line that names the file",
        (
            "tests/unit/runtime/test_safety.py",
            "tests/unit/runtime/test_failures.py",
            "tests/unit/runtime/test_pressure_command.py",
            "tests/unit/runtime/test_controller.py",
            "tests/unit/runtime/test_grasp_outcome.py",
            "tests/cli/test_bad_input.py::test_a_controller_that_misbehaves_is_named",
        ),
    ),
    Kind(
        "notebooks with functions, objects, lists that contain themselves, 10^6 entries",
        "not recorded, named once; the grasp goes on",
        ("tests/unit/core/test_controller_state.py",),
    ),
    Kind(
        "each signal that ends a process, once, repeated, and after another",
        "heard, raised where it does no harm; only a person's second one is at once",
        ("tests/unit/core/test_stop.py",),
    ),
    Kind(
        "arrays of another size, settings drawn at random, meshes that are too coarse",
        "refused by name; no kernel leaves its arrays",
        ("tests/unit/kernels/test_boundary.py", "tests/unit/kernels/test_drawn.py"),
    ),
    Kind(
        "images that are dark, glaring, blurred, with specks, holes and strange markers",
        "unknown with its reason, or right within its error bar",
        (
            "tests/unit/sensing/test_model_error.py",
            "tests/unit/sensing/test_circles_from_images.py",
        ),
    ),
    Kind(
        "scenes with bodies that go through, diverge, weigh on the frame, or are too fast",
        "flagged, or stopped with the reason",
        ("tests/plugin/test_flags.py", "tests/physics/test_stability.py"),
    ),
    Kind(
        "bytes lost, changed, late or babbled on servo buses and valve boards; cables pulled",
        "DeviceError, no wrong reading",
        (
            "tests/unit/devices/test_dynamixel_bus.py",
            "tests/unit/devices/test_dynamixel_trouble.py",
            "tests/unit/devices/test_valve.py",
            "tests/unit/devices/test_valve_protocol.py",
            "tests/unit/devices/test_valve_firmware.py",
            "tests/unit/devices/test_dead_host.py",
        ),
    ),
    Kind(
        "cameras that stop, freeze, lie about their settings or their clock",
        "DeviceError, stale said",
        ("tests/unit/devices/test_camera_driver.py",),
    ),
    Kind(
        "signals, a host that is killed or stands still, a stopped terminal, a full disk, a "
        "controller that eats the memory while something is held",
        "set down, torque off, chambers vented, the recording can be read",
        (
            "tests/contract/test_signals.py",
            "tests/contract/test_red_button.py",
            "tests/contract/test_push_and_memory.py",
        ),
        quick=False,
    ),
)


def run(out: Path, quick: bool = False, resume: bool = False) -> dict[str, Any]:
    """Run the tests of each kind again.

    Args:
        out: the folder for pytest's reports, and for the result after each kind.
        quick: leave out what needs an emulated rig.
        resume: keep the kinds that an interrupted run has counted.

    Raises:
        InputError: there is no pytest.
    """
    say = Progress().message
    path = out / "attacks.json"
    before = json.loads(path.read_text())["kinds"] if resume and path.is_file() else []
    done = {row["what"]: row for row in before}
    kinds = [kind for kind in KINDS if kind.quick or not quick]
    for number, kind in enumerate(kinds):
        if kind.what in done:
            continue
        counts = count(_report(kind.tests, out / f"attacks_{number}.xml"))
        done[kind.what] = {"what": kind.what, "wanted": kind.wanted, **counts}
        say(f"{kind.what}: {counts['as_wanted']} of {counts['tried']}")
        write_json(path, {"kinds": list(done.values())})
    rows = [done[kind.what] for kind in kinds]
    return {"stamp": stamp(), "system": platform.system(), "kinds": rows}


def _report(tests: Sequence[str], path: Path) -> ET.Element:
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", f"--junitxml={path}"]
    # an exit code of 1 says that tests failed: they are counted
    done = subprocess.run(
        [*command, *tests], cwd=CHECKOUT, capture_output=True, text=True, check=False
    )
    if done.returncode > 1 or not path.exists():
        last = (done.stderr or done.stdout).strip().splitlines()[-1]
        raise InputError(f"pytest does not run the attacks: {last} (make venv installs it)")
    return ET.parse(path).getroot()


def count(report: ET.Element) -> dict[str, Any]:
    """Cases of a JUnit report: how many were `tried`, came out `as_wanted`, and which did not; what
    was skipped was not tried."""
    cases = [case for case in report.iter("testcase") if case.find("skipped") is None]
    wrong = [
        case.get("name", "")
        for case in cases
        if case.find("failure") is not None or case.find("error") is not None
    ]
    return {"tried": len(cases), "as_wanted": len(cases) - len(wrong), "wrong": wrong}


def table(result: Mapping[str, Any]) -> str:
    """Markdown."""
    lines = ["| what was tried | cases | what must come of it | came of it |", "|---|---|---|---|"]
    for row in result["kinds"]:
        came = "that, each time"
        if row["wrong"]:
            came = f"{row['as_wanted']} times; not: {', '.join(row['wrong'])}"
        lines.append(f"| {row['what']} | {row['tried']} | {row['wanted']} | {came} |")
    tried = sum(row["tried"] for row in result["kinds"])
    wanted = sum(row["as_wanted"] for row in result["kinds"])
    return "\n".join(lines) + f"\n\n{wanted} of {tried} attacks came out as they must.\n"
