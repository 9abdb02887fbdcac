"""Whoever knows a rig looks at it: the devices' own doctor, or the simulator's."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from mjtactile.rig.file import read_rig_file
from mjtactile.rig.finding import Finding
from mjtactile.rig.simulated import SimRigFile


def examine_rig(name: str | None, *, sensor: str = "dense", fix: bool = False) -> list[Finding]:
    """What is found of the rig `name`, or of what is plugged in (None); `sensor` where the rig file
    does not say it. `fix`: mend what software can. Raises InputError for a bad rig file.

    A simulated rig has no devices to look for, and real devices need no simulator.
    """
    rig = None if name is None else read_rig_file(name)
    if isinstance(rig, SimRigFile):
        from mjtactile.sim.doctor import examine_simulated

        return examine_simulated(rig)
    from mjtactile.devices.doctor import examine

    return examine(name, sensor=sensor, fix=fix)


def plugged_in(
    more: Iterable[str] = (), *, ask: bool = True, say: Callable[[str], None] = lambda _: None
) -> tuple[list[Any], list[Any]]:
    """Cameras (`VideoDevice`) and serial ports (`SerialPort`), those of `more` too; `ask` who
    answers on the ports."""
    from mjtactile.devices.camera.v4l2 import video_devices
    from mjtactile.devices.listing import serial_ports

    return video_devices(), serial_ports(more, ask=ask, say=say)
