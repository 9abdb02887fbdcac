"""`mjtactile bench fault-injection`: fault injections of the test suite, counted by expected
outcome.

An attack is one case of a test: a file with one error, a changed byte on a wire, a signal during a
hold. The tests evaluate it. Here they run again and are counted, so that the table lists exactly
the attacks that ran.
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
    """Attacks of one kind: description, expected outcome, and the tests (pytest names).

    `quick` kinds need no emulated rig.
    """

    fault: str
    required: str
    tests: Sequence[str]
    quick: bool = True


KINDS = (
    Kind(
        "files with one error; invalid arguments",
        "rejected in one line with exit code 2; no files left",
        (
            "tests/cli/test_bad_input.py",
            "tests/cli/test_calibration_files.py",
            "tests/unit/rig/test_rigfile.py",
            "tests/unit/core/test_toml.py",
            "tests/physics/test_robots.py::test_an_invalid_robot_is_refused_in_one_line",
        ),
    ),
    Kind(
        "damaged or foreign recordings; full disks, no file descriptors, removed folders",
        "rejected with line and column, or complete up to the damage",
        (
            "tests/unit/recording/test_damaged.py",
            "tests/unit/recording/test_recording.py",
            "tests/unit/evaluate/test_pool.py",
        ),
    ),
    Kind(
        "controllers that raise, hang, exit, request NaN or excessive values, end with a "
        "raised gripper, or cannot be imported",
        "gripper retreats; one line names the file",
        (
            "tests/unit/runtime/test_safety.py",
            "tests/unit/runtime/test_failures.py",
            "tests/unit/runtime/test_pressure_command.py",
            "tests/unit/runtime/test_controller.py",
            "tests/unit/runtime/test_grasp_outcome.py",
            "tests/cli/test_bad_input.py::test_a_faulty_controller_is_named",
        ),
    ),
    Kind(
        "scenarios that name unbuildable sensors or programs",
        "rejected; no program of a file runs",
        ("tests/unit/rig/test_scenario.py",),
    ),
    Kind(
        "files that need much memory or time: includes, textures, height fields, images, "
        "archives; pipes, devices, long names",
        "rejected within the limits; this process never has the memory",
        (
            "tests/unit/sim/test_mjcf.py",
            "tests/unit/sim/test_meshes.py",
            "tests/unit/core/test_foreign_file.py",
            "tests/unit/core/test_image_decoding.py",
            "tests/unit/core/test_policy_file.py",
            "tests/unit/core/test_camera_file.py",
        ),
    ),
    Kind(
        "requests of other pages and origins to local servers; used ports",
        "refused; Studio and Foxglove connect",
        (
            "tests/unit/core/test_loopback.py",
            "tests/unit/studio/test_local_server.py",
            "tests/unit/studio/test_serve.py",
        ),
    ),
    Kind(
        "membranes that are too stiff for their camera",
        "sd of the minimum detectable force; named above 0.1 N",
        ("tests/unit/sensing/test_touch_state.py",),
    ),
    Kind(
        "copies of a bound sensor, another model, options changed after `bind`, steps "
        "before a reset",
        "one named error",
        ("tests/plugin/test_misuse.py",),
    ),
    Kind(
        "controller state with functions, objects, 10^6 entries",
        "not recorded, reported once; the grasp continues",
        ("tests/unit/core/test_controller_state.py",),
    ),
    Kind(
        "each termination signal: once, repeated, after another one",
        "raised at a safe point; only the second signal of a user acts immediately",
        ("tests/unit/core/test_stop.py",),
    ),
    Kind(
        "arrays of another size, random settings, too coarse meshes",
        "rejected by name; no kernel accesses memory outside its arrays",
        ("tests/unit/kernels/test_boundary.py", "tests/unit/kernels/test_random_arguments.py"),
    ),
    Kind(
        "dark, overexposed or blurred images; specks, holes",
        "unknown with a reason, or correct within the reported uncertainty",
        (
            "tests/unit/sensing/test_model_error.py",
            "tests/unit/sensing/test_circles_from_images.py",
        ),
    ),
    Kind(
        "objects that pass through the membrane, diverge, load the frame, or are too fast",
        "flagged, or stopped with a reason",
        ("tests/plugin/test_flags.py", "tests/physics/test_stability.py"),
    ),
    Kind(
        "bytes lost, changed, late or random on buses; unplugged cables",
        "DeviceError, no wrong reading",
        (
            "tests/unit/devices/test_dynamixel_bus.py",
            "tests/unit/devices/test_dynamixel_faults.py",
            "tests/unit/devices/test_valve.py",
            "tests/unit/devices/test_valve_protocol.py",
            "tests/unit/devices/test_valve_firmware.py",
            "tests/unit/devices/test_dead_host.py",
        ),
    ),
    Kind(
        "cameras that stop, freeze, or report wrong settings",
        "DeviceError that names the stale image",
        ("tests/unit/devices/test_camera_driver.py",),
    ),
    Kind(
        "while an object is held: signals, a killed or paused host, a full disk, exhausted memory",
        "object set down, torque off, chambers vented, readable recording",
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
        out: Folder for pytest's reports, and for the result after each kind.
        quick: Leave out kinds that need an emulated rig.
        resume: Keep the kinds that an interrupted run has counted.

    Raises:
        InputError: pytest is not installed.
    """
    notify = Progress().message
    path = out / "attacks.json"
    before = json.loads(path.read_text())["kinds"] if resume and path.is_file() else []
    done = {row["fault"]: row for row in before}
    kinds = [kind for kind in KINDS if kind.quick or not quick]
    for number, kind in enumerate(kinds):
        if kind.fault in done:
            continue
        counts = count(_report(kind.tests, out / f"attacks_{number}.xml"))
        done[kind.fault] = {"fault": kind.fault, "required": kind.required, **counts}
        notify(f"{kind.fault}: {counts['passed']} of {counts['cases']}")
        write_json(path, {"kinds": list(done.values())})
    rows = [done[kind.fault] for kind in kinds]
    return {"stamp": stamp(), "system": platform.system(), "kinds": rows}


def _report(tests: Sequence[str], path: Path) -> ET.Element:
    report = f"--junitxml={path.resolve()}"  # pytest runs in the checkout
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", report]
    # exit code 1: some tests failed; they are counted
    done = subprocess.run(
        [*command, *tests], cwd=CHECKOUT, capture_output=True, text=True, check=False
    )
    if done.returncode > 1 or not path.exists():
        last = (done.stderr or done.stdout).strip().splitlines()[-1]
        raise InputError(f"pytest does not run the attacks: {last} (make venv installs it)")
    return ET.parse(path).getroot()


def count(report: ET.Element) -> dict[str, Any]:
    """Count the cases of a JUnit report: `cases`, `passed`, and names of failures.

    Skipped cases do not count.
    """
    cases = [case for case in report.iter("testcase") if case.find("skipped") is None]
    wrong = [
        case.get("name", "")
        for case in cases
        if case.find("failure") is not None or case.find("error") is not None
    ]
    return {"cases": len(cases), "passed": len(cases) - len(wrong), "wrong": wrong}


def table(result: Mapping[str, Any]) -> str:
    """Format the result as a Markdown table."""
    lines = ["| injected fault | cases | required reaction |", "|---|---|---|"]
    for row in result["kinds"]:
        wrong = f" ({row['passed']} met; not: {', '.join(row['wrong'])})" if row["wrong"] else ""
        lines.append(f"| {row['fault']} | {row['cases']}{wrong} | {row['required']} |")
    cases = sum(row["cases"] for row in result["kinds"])
    passed = sum(row["passed"] for row in result["kinds"])
    return "\n".join(lines) + f"\n\n{passed} of {cases} cases meet the requirement.\n"
