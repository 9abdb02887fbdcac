"""Record a short squeeze, then replay it.

The same images through the same chain give the same numbers, bit for bit. An optional folder
replaces the recording: `python replay_a_recording.py runs/egg` replays the output of `mjtactile
grasp --out runs/egg`.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import mjtactile


class Squeeze:
    """Controller that closes until both fingers estimate 0.2 N; a controller needs only `step`."""

    path = Path(__file__)

    def step(self, observation):
        command = observation.command
        if min(touch.force_normal for touch in observation.touch) > 0.2:
            return replace(command, phase="done")
        return replace(
            command,
            opening=command.opening - 0.04 * observation.period,
            force_limit=3.0,
            phase="close",
        )


def run(rig, sensor, folder):
    """Squeeze on `rig`, and record to `folder`."""
    design = mjtactile.load_sensor(sensor)
    header = {"sensor": sensor, "rig": rig, "object": "vial"}
    with (
        mjtactile.Recorder(folder, header) as recorder,
        mjtactile.open_session(rig, design, object_name="vial") as session,
    ):
        session.take_references(recorder)
        session.run(Squeeze(), time_limit=20, on_cycle=recorder.add)


work = Path(tempfile.mkdtemp())
given = sys.argv[1] if len(sys.argv) > 1 else None
if given is None:
    run("sim", "paper16", work / "first")
first = mjtactile.load_recording(given or work / "first")
run(f"replay:{first.folder}", str(first.header["sensor"]), work / "again")
again = mjtactile.load_recording(work / "again")

count = min(len(first), len(again))
same = {
    key: np.array_equal(first.column(key)[:count], again.column(key)[:count], equal_nan=True)
    for key in ("force_normal", "wrench", "contact_area")
}
print(
    f"{count} cycles, the last estimate {again.column('force_normal')[-1]} N; the same bits: {same}"
)
