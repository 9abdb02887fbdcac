"""`Calibration`: measured parameters of one finger's sensor, by part, and their use in place of the
sensor file's values.

Each finger has one JSON file. Every `mjtactile calibrate` adds its part
(`mjtactile.core.calibration_parts`). A rejected part is noted with its reasons and does not replace
any value.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mjtactile.core.calibration_parts import (
    KINDS,
    CalibrationMetadata,
    ForceScale,
    FrameCalibration,
    LensCalibration,
    Part,
    ValveZero,
    fingerprint,
    now,
)
from mjtactile.core.config_fields import entry, read, read_fields, text, write
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.field_types import Texts
from mjtactile.core.signature_checks import validated
from mjtactile.core.toml import Section, read_json
from mjtactile.core.types import PressureReading, ValveState

FORMAT = "mjtactile-calibration"
VERSION = 1
GAUGE_SD = 5.0
"""Noise of an uncalibrated pressure sensor, Pa."""
_RESOLUTION = 0.5  # resolution of a valve board's readings, Pa


@dataclass(frozen=True)
class Refusal:
    """A part that was measured and refused: `date` and `reasons`."""

    date: str = text("date")
    reasons: tuple[str, ...] = entry(Texts(key="reasons"))


@dataclass(frozen=True)
class PartState:
    """State of one part: `state` "good", "missing", "outdated" or "refused", with an explanatory
    sentence."""

    kind: str
    state: str
    text: str


@validated()
@dataclass(frozen=True, eq=False)
class Calibration:
    """Calibration of one finger's sensor. For a part that is None, the sensor file's values apply.

    Attributes:
        finger: Name of the finger.
        sensor: Name of its sensor.
        lens: Intrinsics and distortion.
        frame: Camera pose in S, marker radii, and the rest state.
        valve: Zero and noise of the pressure sensor.
        force: Ratio of ground truth to estimated force.
        refused: The newest refusal of each part since its last success.
    """

    finger: str
    sensor: str
    lens: LensCalibration | None = None
    frame: FrameCalibration | None = None
    valve: ValveZero | None = None
    force: ForceScale | None = None
    refused: Mapping[str, Refusal] = field(default_factory=dict)

    @validated()
    def part(self, kind: str) -> Part | None:
        """Return one part.

        Args:
            kind: One of "lens", "frame", "valve", "force".

        Returns:
            The part, or None where it was never measured.

        Raises:
            InputError: An unknown kind.
        """
        if kind not in KINDS:
            raise InputError(f"{kind!r} is unknown", source="part", field="kind", choices=KINDS)
        return getattr(self, kind)

    @validated()
    def with_part(self, part: Part) -> Calibration:
        """Replace a part and delete its refusal.

        Args:
            part: The new part.

        Returns:
            A new calibration.
        """
        refused = {kind: refusal for kind, refusal in self.refused.items() if kind != part.kind}
        return replace(self, **{part.kind: part}, refused=refused)

    @validated()
    def with_refusal(self, kind: str, reasons: Sequence[str]) -> Calibration:
        """Record the refusal of a part now. A valid part stays.

        Args:
            kind: Which part.
            reasons: Reasons, one sentence each.

        Returns:
            A new calibration.
        """
        return replace(self, refused={**self.refused, kind: Refusal(now(), tuple(reasons))})

    @validated()
    def used(self, design: SensorDesign) -> Calibration:
        """Remove the outdated parts, for use in a sensing pipeline.

        Args:
            design: The current sensor file.

        Returns:
            A calibration without them.
        """
        old = [state.kind for state in self.states(design) if state.state == "outdated"]
        return replace(self, **dict.fromkeys(old)) if old else self

    @validated()
    def states(self, design: SensorDesign) -> list[PartState]:
        """Return the state of every part.

        Args:
            design: The current sensor file.

        Returns:
            One state per part: good, missing, outdated or refused, and the reason.
        """
        return [self._state(kind, design) for kind in KINDS]

    def _state(self, kind: str, design: SensorDesign) -> PartState:
        part = self.part(kind)
        refusal = self.refused.get(kind)
        if part is None:
            if refusal is None:
                return PartState(kind, "missing", "never measured: the sensor file's values apply")
            text = f"refused on {_day(refusal.date)}: {'; '.join(refusal.reasons)}"
            return PartState(kind, "refused", text)
        newer = [
            other
            for other in part.rests_on
            if (found := self.part(other)) and found.stamp.date > part.stamp.date
        ]
        text = f"of {_day(part.stamp.date)}"
        if newer:
            problem = f"not used: older than the {newer[0]} that it was measured with"
            return PartState(kind, "outdated", problem)
        if part.of_sensor and part.stamp.fingerprint != fingerprint(design):
            problem = f"{text}: not used, because values of the sensor file have changed since"
            return PartState(kind, "outdated", problem)
        if refusal is not None:
            reasons = "; ".join(refusal.reasons)
            text += f"; measured again on {_day(refusal.date)} and refused: {reasons}"
        return PartState(kind, "good", text)

    @validated()
    def design(self, design: SensorDesign) -> SensorDesign:
        """Replace the sensor file's values by the measured ones.

        Args:
            design: The sensor file's values.

        Returns:
            The design with the measured lens.
        """
        if self.lens is None:
            return design
        return replace(design, camera=replace(design.camera, **self.lens.intrinsics))

    @validated()
    def pressure(self, reading: float) -> float:
        """Subtract the zero of the pressure sensor from a reading.

        Args:
            reading: Reading of the sensor, Pa.

        Returns:
            Gauge pressure, Pa.
        """
        return reading if self.valve is None else reading - self.valve.offset

    @validated()
    def check(self, design: SensorDesign, finger: str, source: object) -> None:
        """Check that this calibration belongs to a finger and its sensor.

        Args:
            design: The finger's sensor.
            finger: Its name.
            source: The file, for the message.

        Raises:
            InputError: It is another finger's, another sensor's, or of another image size.
        """
        if self.finger != finger:
            message = f"belongs to finger {self.finger!r}, not {finger!r}"
            raise InputError(message, source=source, field="finger")
        if self.sensor != design.name:
            message = (
                f"belongs to sensor {self.sensor!r}, but the {finger} finger has {design.name!r}; "
                f"a file fitted to the same sensor must also be named {self.sensor}.toml"
            )
            raise InputError(message, source=source, field="sensor")
        size = design.camera.width, design.camera.height
        if self.lens is not None and (self.lens.width, self.lens.height) != size:
            message = (
                f"{self.lens.width} x {self.lens.height} pixels, but sensor {design.name!r} has "
                f"{size[0]} x {size[1]}"
            )
            raise InputError(message, source=source, field="lens.width_px")

    def table(self) -> dict[str, Any]:
        """Convert to a table.

        Returns:
            The table of a calibration file, and of a recording's header.
        """
        parts = {kind: self.part(kind) for kind in KINDS}
        return {
            "format": FORMAT,
            "version": VERSION,
            "finger": self.finger,
            "sensor": self.sensor,
            **{kind: part and {**write(part), **write(part.stamp)} for kind, part in parts.items()},
            "refused": {kind: write(refusal) for kind, refusal in self.refused.items()},
        }

    @validated()
    def save(self, path: str | Path) -> None:
        """Write the file atomically.

        Args:
            path: Path of the file.

        Raises:
            InputError: It cannot be written.
        """
        path = Path(path)
        if not path.name:
            raise InputError("is not a file", source=path, field="calibration")
        part = path.with_name(path.name + ".part")
        try:
            part.write_text(json.dumps(self.table(), indent=1) + "\n", encoding="utf-8")
            part.replace(path)
        except OSError as error:
            message = f"cannot be written: {error.strerror}"
            raise InputError(message, source=path, field="calibration") from error


@validated()
def load_calibration(path: str | Path) -> Calibration:
    """Read a calibration file.

    Args:
        path: The file, JSON.

    Returns:
        The calibration.

    Raises:
        InputError: The file is not a calibration file; names the file and the field.
    """
    return calibration_from_table(read_json(Path(path)), str(path))


def calibration_from_table(table: Any, source: str) -> Calibration:
    """Read the table written by `Calibration.table`; `source` names its file. Raises InputError
    naming the field."""
    if not isinstance(table, Mapping) or (table.get("format"), table.get("version")) != (
        FORMAT,
        VERSION,
    ):
        choices = [f"{FORMAT} version {VERSION}"]
        raise InputError(
            "is not a calibration file", source=source, field="format", choices=choices
        )
    root = Section(table, "", source)
    finger = root.text("finger")
    sensor = root.text("sensor")
    parts: dict[str, Any] = {
        kind: read(
            part, found, stamp=CalibrationMetadata(**read_fields(CalibrationMetadata, found))
        )
        for kind, part in KINDS.items()
        if (found := root.optional(kind)) is not None
    }
    notes = root.section("refused")
    refused = {
        kind: read(Refusal, found) for kind in KINDS if (found := notes.optional(kind)) is not None
    }
    return Calibration(finger, sensor, **parts, refused=refused)


def _day(date: str) -> str:
    return date[:10]


def pressure_reading(
    valve: ValveState, calibration: Calibration | None = None
) -> PressureReading | None:
    """Return the pressure of a chamber from the state of its `valve`, corrected by the finger's
    `calibration`. None without a pressure sensor or a reading."""
    if valve.gauge_pressure is None or not math.isfinite(valve.gauge_pressure + valve.time):
        return None
    zero = None if calibration is None else calibration.valve
    pressure = valve.gauge_pressure - (0.0 if zero is None else zero.offset)
    sd = GAUGE_SD if zero is None else max(zero.noise_sd, _RESOLUTION)
    return PressureReading(pressure, sd, valve.time, valve.is_open)
