"""Start options of the emulator process."""

from __future__ import annotations

import base64
import pickle
from dataclasses import dataclass, field

from mjtactile.core.design import SensorDesign
from mjtactile.rig.file import RigFile
from mjtactile.rig.sensors import finger_design


@dataclass(frozen=True)
class EmulatorOptions:
    """Options of the emulator: rig, sensor on each finger, and object on the table.

    `seed` is that of placement and noise. `faults` are present from the start.
    """

    rig_file: RigFile
    design: SensorDesign
    object_name: str
    seed: int = 0
    faults: dict[str, float] = field(default_factory=dict)

    def finger_design(self, finger: str) -> SensorDesign:
        """Return the sensor design of that finger, from its sensor file."""
        return next(
            (finger_design(c, self.design) for c in self.rig_file.cameras if c.finger == finger),
            self.design,
        )

    def encode(self) -> str:
        """Encode the options as one line of text for the stdin of the process."""
        return base64.b64encode(pickle.dumps(self)).decode("ascii")

    @staticmethod
    def decode(line: str) -> EmulatorOptions:
        return pickle.loads(base64.b64decode(line))
