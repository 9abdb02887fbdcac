"""An interrupted run reports so in one line, exits with 3, and leaves a readable recording."""

import json
import signal
import subprocess
import sys
import time

import numpy as np

from mjtactile.recording.reader import load_recording

GRASP = [sys.executable, "-m", "mjtactile", "grasp", "--sensor", "paper16", "--out", "result"]
GRASP += ["--workers", "1"]  # a process that the signal must end, too
WAIT = 600  # time limit for the start of the run on a heavily loaded computer, s


def test_an_interrupted_recording_is_kept(tmp_path):
    process = subprocess.Popen(
        [*GRASP, "--json"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    log = tmp_path / "result" / "recording" / "log.jsonl"
    deadline = time.monotonic() + WAIT
    while time.monotonic() < deadline and not (
        log.exists() and log.read_text().count('"cycle"') >= 10
    ):
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=WAIT)
    assert process.returncode == 3
    assert stderr.strip().splitlines()[-1] == "mjtactile: interrupted" and "Traceback" not in stderr
    report = json.loads(stdout)
    assert (
        report["outcome"] == "fault" and report["exit_code"] == 3 and report["hold_force_N"] is None
    )
    assert json.loads((tmp_path / "result" / "summary.json").read_text())["outcome"] == "fault"
    recording = load_recording(tmp_path / "result")
    assert recording.complete and len(recording) == report["frames"] >= 10
    assert np.isfinite(recording.column("force_normal")).all()
    assert all(
        image.pixels.shape == (480, 640) for images in recording.images() for image in images
    )


def test_a_run_that_is_killed_leaves_complete_cycles(tmp_path):
    """After SIGKILL the recording holds all finished cycles, each with its images, although no
    handler runs."""
    process = subprocess.Popen(
        GRASP, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    log = tmp_path / "result" / "recording" / "log.jsonl"
    deadline = time.monotonic() + WAIT
    while time.monotonic() < deadline and not (
        log.exists() and log.read_text().count('"cycle"') >= 5
    ):
        time.sleep(0.05)
    process.kill()
    process.wait()
    recording = load_recording(tmp_path / "result")
    assert not recording.complete and len(recording) >= 5
    assert len(list(recording.images())) == len(recording)
