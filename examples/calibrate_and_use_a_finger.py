"""Calibrated finger: a calibration file replaces the lens of the sensor file.

`mjtactile calibrate camera --rig my_gripper.toml --finger left`, then `valve`, `frame`, `force` and
`gripper`, measure the parts and write them into the files that the rig file names
(docs/how-to/hardware.md). `grasp`, `probe` and `record` then use them. The result of `frame` is for
`reconstruct`, which processes single images. The other commands measure it again at their start.

Here the finger is simulated, so its true lens is known. It differs from that of the sensor file, as
on every real finger.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import mjtactile

work = Path(tempfile.mkdtemp())
sensor = mjtactile.load_sensor("paper16")
camera = replace(
    sensor.camera, fx=1.03 * sensor.camera.fx, fy=1.03 * sensor.camera.fy, cx=sensor.camera.cx + 6
)


class Squeeze:
    """Close to 20 mm regardless of touch, so that every run below is the same squeeze."""

    path = Path(__file__)

    def step(self, observation):
        command = observation.command
        opening = command.opening - 0.03 * observation.period
        return replace(
            command, opening=opening, force_limit=3.0, phase="done" if opening < 0.02 else "close"
        )


def estimated_forces(rig, design, calibrations=(None, None), recorder=None):
    """Return the normal forces, N, (cycles, fingers) of a squeeze on `rig`, with the given
    `calibrations`."""
    forces = []
    try:
        session = mjtactile.Session(
            rig, [mjtactile.StatefulPipeline.of(design, known) for known in calibrations]
        )
        session.take_references(recorder)
        session.run(
            Squeeze(),
            time_limit=20,
            on_cycle=lambda cycle: (
                recorder and recorder.add(cycle),
                forces.append([touch.force_normal for touch in cycle.touch]),
            ),
        )
    finally:
        rig.close()
    return np.array(forces)


# by chains with the true lens
with mjtactile.Recorder(work / "squeeze", {"sensor": "paper16"}) as recorder:
    true = estimated_forces(
        mjtactile.build_rig("sim", replace(sensor, camera=camera), object_name="vial"),
        replace(sensor, camera=camera),
        recorder=recorder,
    )

stamp = mjtactile.CalibrationMetadata(
    "2026-01-31T12:00:00+00:00", "by hand", residuals={"rms_px": 0.2}
)
lens = mjtactile.LensCalibration(**camera.intrinsics, stamp=stamp)  # or from your own calibration
mjtactile.Calibration("left", sensor.name).with_part(lens).save(work / "left.json")

known = mjtactile.load_calibration(work / "left.json")
for name, calibrations in (
    ("as the sensor file says", (None, None)),
    ("left finger calibrated", (known, None)),
):
    forces = estimated_forces(
        mjtactile.build_rig(f"replay:{work / 'squeeze'}", sensor), sensor, calibrations
    )
    print(
        f"{name}: off by {np.nanmax(np.abs(forces - true[: len(forces)]), axis=0).round(3)} N "
        "(left, right)"
    )
