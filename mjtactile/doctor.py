"""Entry point of the rig checks: the doctor of the devices, or that of the simulator."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Image
from mjtactile.rig.doctor_finding import Finding
from mjtactile.rig.file import read_rig_file
from mjtactile.rig.simulated import SimRigFile
from mjtactile.sensing.pipeline import SensingPipeline


def examine_rig(name: str | None, *, sensor: str = "dense", fix: bool = False) -> list[Finding]:
    """Return the findings for the rig `name`, or for the connected devices (None).

    `sensor` applies if the rig file has none. `fix`: correct problems that software can correct.
    Raises InputError for an invalid rig file.

    A simulated rig has no devices to check, and real devices need no simulator.
    """
    rig = None if name is None else read_rig_file(name)
    if isinstance(rig, SimRigFile):
        from mjtactile.sim.doctor import examine_simulated

        return examine_simulated(rig, sensor)
    from mjtactile.devices.doctor import examine

    return examine(name, sensor=sensor, fix=fix, check_view=fiducial_findings)


def fiducial_findings(subject: str, design: SensorDesign, image: Image) -> Iterator[Finding]:
    """Check that an image of the camera `subject` shows the sensor's fiducials at their expected
    positions. No findings for a sensor without fiducials."""
    if design.fiducials is None:
        return
    sensing_pipeline = SensingPipeline(design)
    _, state = sensing_pipeline.detect_markers(sensing_pipeline.initial_state(), image)
    known = sensing_pipeline.detector.known
    assert known is not None
    seen = 0 if state.fiducials is None else len(state.fiducials)
    text = f"{seen} of {known.count} fiducials detected"
    if state.fiducials is None or seen < known.min_visible:
        yield Finding(
            "bad",
            subject,
            f"{text}, {known.min_visible} are needed: a shift of the camera by a bump or by heat "
            "stays unknown",
            "check that the image is upright (`flipped`), centered, sharp and clean at its "
            "edges, and that the sensor file belongs to this sensor",
        )
        return
    (right, down), scale = known.shift_and_scale(state.fiducials)
    level = "ok" if seen == known.count else "warn"
    yield Finding(
        level,
        subject,
        f"{text}; relative to the sensor file the image is shifted by {right:+.1f} px right "
        f"and {down:+.1f} px down, and is {100 * (scale - 1):+.1f} % larger",
        "" if level == "ok" else "clean the glass; check that the light is even",
    )


def plugged_in(
    more: Iterable[str] = (), *, ask: bool = True, notify: Callable[[str], None] = lambda _: None
) -> tuple[list[Any], list[Any]]:
    """List the cameras (`VideoDevice`) and serial ports (`SerialPort`), including the ports `more`.
    With `ask`, identify the devices on the ports."""
    from mjtactile.devices.camera.v4l2 import video_devices
    from mjtactile.devices.discovery import serial_ports

    return video_devices(), serial_ports(more, ask=ask, notify=notify)
