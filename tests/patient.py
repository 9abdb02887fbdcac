"""Sensor of the contract tests, simulated rigs, and the emulated rig with longer time-outs."""

from dataclasses import replace

from mjtactile.core.design import load_sensor
from mjtactile.rig.file import load_rig_file

DESIGN = load_sensor("paper16")
# Half of the usual images: two processors render and evaluate those of seven emulated rigs.
RATE = 15.0  # image rate of emulated cameras, Hz
SLOW_CAMERA_DESIGN = replace(DESIGN, camera=replace(DESIGN.camera, rate=RATE))
SIMULATED = ("sim", "sim_arm", "sim_three_finger")


def patient_rig_file():
    """Write the shipped emulated rig with time-outs for a computer with other load."""
    rig_file = load_rig_file("emulated")
    # stale only after 0.6 s
    cameras = tuple(replace(camera, delay=0.5, rate=RATE) for camera in rig_file.cameras)
    return replace(
        rig_file,
        bus=replace(rig_file.bus, reply_timeout=0.25, watchdog=2.5, host_timeout=5.0),
        cameras=cameras,
        valves=tuple(replace(valve, heartbeat=3.0, reply_timeout=0.1) for valve in rig_file.valves),
    )
