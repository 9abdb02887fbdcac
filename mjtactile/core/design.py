"""`SensorDesign`: complete description of a sensor, read from a TOML file and validated. It is used
by the simulator *and* by sensing. Its parts: `mjtactile.core.sensor_parts`.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjtactile.core import optics, resources
from mjtactile.core.config_fields import (
    ML,
    MM,
    file_path,
    from_table,
    part,
    read,
    text,
    write_fields,
)
from mjtactile.core.errors import InputError
from mjtactile.core.fiducials import Fiducials
from mjtactile.core.relaxation import Relaxation
from mjtactile.core.sensor_parts import (
    CameraDesign,
    Chamber,
    Frame,
    FrameShape,
    Glass,
    Leds,
    MarkerLayout,
    Membrane,
)
from mjtactile.core.signature_checks import validated
from mjtactile.core.toml import Section, parse_toml, read_toml_with_text, toml_text

_TEXT = "_source_text"  # attribute of a design with the text of its file
_SAME_POINT = 1e-6
_RIM = 2 * np.pi * np.arange(16) / 16  # points on a marker's edge
_NAMED_MAX = 5  # markers listed in a message
_FARTHER = 1.005  # step of the search for a distance that shows all markers
_FEWEST_MARKERS = 9  # minimum number of markers within an outline
_SPLINE_NUMBERS_MAX = 5776  # 73 x 73 markers: a quarter of a GiB for a matrix


@dataclass(frozen=True)
class SensorDesign:
    """Complete sensor. Create one with `load_sensor`, or directly with SI values.

    Attributes:
        name: Name of the sensor.
        frame: The frame that the membrane is clamped in.
        membrane: The rubber membrane.
        markers: The circles on its inner side.
        chamber: The gas behind the membrane, with supply and valve.
        glass: The glass in front of the camera.
        camera: Pose, lens, image size and rate.
        leds: The illumination.
        fiducials: Fixed circles next to the membrane; None: there are none.
        relaxation: Stress relaxation of the membrane; None: none.
        calibration: Calibration file named in a finger's own sensor file; None: no file.
    """

    name: str = text("name")
    frame: Frame = part("frame", Frame)
    membrane: Membrane = part("membrane", Membrane)
    markers: MarkerLayout = part("markers", MarkerLayout)
    chamber: Chamber = part("chamber", Chamber)
    glass: Glass = part("glass", Glass)
    camera: CameraDesign = part("camera", CameraDesign)
    leds: Leds = part("leds", Leds, default=Leds())
    fiducials: Fiducials | None = part("fiducials", Fiducials, default=None)
    relaxation: Relaxation | None = part("relaxation", Relaxation, default=None)
    calibration: Path | None = file_path("calibration", compare=False)

    def __post_init__(self) -> None:
        """Pass the frame's outline to the markers, which must lie inside it."""
        frame = None if self.frame.shape == FrameShape.RECTANGLE else self.frame
        if self.markers.frame != frame:
            object.__setattr__(self, "markers", replace(self.markers, frame=frame))

    @property
    def file_text(self) -> str:
        """The sensor in file format: the text that it was read from, or one that reads back to the
        same values."""
        known = vars(self).get(_TEXT)
        return toml_text(write_fields(self)) if known is None else known

    def stored_file(self) -> dict[str, str]:
        """Return `file_text` as recordings keep it.

        Returns:
            Name, text, and the text's SHA-256.
        """
        content = self.file_text
        checksum = hashlib.sha256(content.encode()).hexdigest()
        return {"name": self.name, "sha256": checksum, "text": content}

    @validated()
    def has_values_of(self, other: SensorDesign) -> bool:
        """Compare two sensors by content.

        Args:
            other: The other sensor.

        Returns:
            True if all values agree; name and calibration file may differ.
        """
        own, others = (
            write_fields(replace(design, name="", calibration=None)) for design in (self, other)
        )
        return own == others

    def require_rectangle(self, purpose: str) -> None:
        """Reject a frame that is not rectangular.

        Args:
            purpose: Component that supports rectangles only, for the message.

        Raises:
            InputError: The frame is not rectangular.
        """
        if self.frame.shape != FrameShape.RECTANGLE:
            raise InputError(
                f"{str(self.frame.shape)!r} can be simulated, but {purpose} supports "
                "rectangles only",
                source=self.name,
                field="frame.shape",
                choices=[str(FrameShape.RECTANGLE)],
            )

    def require_markers_that_fit(self) -> None:
        """Reject a marker count that exceeds the memory available for sensing.

        The surface splines have (rows + 3) (columns + 3) coefficients, and square matrices of them.

        Raises:
            InputError: There are too many.
        """
        size = (self.markers.rows + 3) * (self.markers.columns + 3)
        if size > _SPLINE_NUMBERS_MAX:
            gib = 8 * size**2 / 2**30
            message = (
                f"{self.markers.rows} x {self.markers.columns} markers can be simulated, but "
                f"sensing needs {gib:.1f} GiB for each of its matrices; the limit is (rows + "
                f"3) (columns + 3) = {_SPLINE_NUMBERS_MAX}"
            )
            raise InputError(message, source=self.name, field="markers.rows")

    @property
    def apparent_glass_thickness(self) -> float:
        """Depth by which the glass brings the scene closer on the camera's axis, t (1 - 1/n), m."""
        return self.glass.thickness * (1 - 1 / self.glass.refractive_index)

    @cached_property
    def chamber_volume_flat(self) -> float:
        """Gas volume with a flat membrane, m^3."""
        volume = self.frame.area * self.chamber.depth + self.chamber.extra_volume
        return volume if self.fiducials is None else volume + self.fiducials.volume(self)

    def markers_outside_image(self) -> NDArray[np.int64]:
        """Return the indices of the flat membrane's markers that are not completely in the image.

        Behind its fold, a lens model maps other points to the same pixels.

        Returns:
            Indices into the marker layout; empty: all are visible.
        """
        camera = self.camera
        edge = self.markers.radius * np.column_stack([np.cos(_RIM), np.sin(_RIM), 0 * _RIM])
        p_CP = self.markers.p_SM[:, None] + edge - camera.p_SC
        uv = optics.project(optics.Camera.from_design(camera, self.glass), p_CP)
        inside = (uv > -0.5) & (uv < (camera.width - 0.5, camera.height - 0.5))
        ideal = p_CP[..., :2] / p_CP[..., 2:]
        # the inverse is exact to 1e-13, and a point behind the fold is a whole image away
        inside &= np.abs(camera.lens.undistort(camera.lens.distort(ideal)) - ideal) < _SAME_POINT
        return np.flatnonzero(~inside.all(axis=(1, 2)))

    def validate(self, section: Section) -> None:
        """Check that the fields are physically consistent.

        Args:
            section: The file's table, for the message.

        Raises:
            InputError: Markers overlap or leave the frame, the camera distance is smaller than the
                chamber's depth, markers are outside the image or brighter than the membrane, or
                fiducials are not visible.
        """
        _check_markers(self, section)
        _check_depth(self, section)
        _check_view(self, section)
        if self.leds.marker_dn >= self.leds.membrane_dn:
            raise section.fail("leds.marker_DN", "markers must be darker than the membrane")
        if self.fiducials is not None:
            self.fiducials.check(self, section)
        if self.relaxation is not None:
            self.relaxation.check(section)


@validated()
def load_sensor(name_or_path: str | Path | SensorDesign) -> SensorDesign:
    """Read a sensor.

    Args:
        name_or_path: A shipped name, a TOML file, or a design, which is returned as it is.

    Returns:
        The sensor, SI.

    Raises:
        InputError: Names file, field, value and valid choices of a field that is missing, misspelt,
            negative, not finite or in another unit.
    """
    if isinstance(name_or_path, SensorDesign):
        return name_or_path
    path = resources.find(name_or_path, "models/sensors", ".toml")
    table, source_text = read_toml_with_text(path)
    return _with_text(sensor_from_table(table, name=path.stem, source=str(path)), source_text)


def require_valid(design: SensorDesign) -> None:
    """Check a sensor's values as those of a file. Raises InputError."""
    for name, value in vars(design).items():
        if value is None and name not in ("fiducials", "relaxation", "calibration"):
            raise InputError("is None", source="SensorDesign", field=name)
    try:
        from_table(SensorDesign, write_fields(design), "SensorDesign")
    except (TypeError, AttributeError) as error:
        message = f"a value has a wrong type: {error}"
        raise InputError(message, source="SensorDesign") from error


def sensor_from_text(content: str, *, name: str, source: str) -> SensorDesign:
    """Read a sensor from the text of its file, as `sensor_from_table` does."""
    table = parse_toml(content, source)
    return _with_text(sensor_from_table(table, name=name, source=source), content)


def _with_text(design: SensorDesign, source_text: str) -> SensorDesign:
    """Attach the text that a sensor was read from; a changed copy has none."""
    object.__setattr__(design, _TEXT, source_text)
    return design


def sensor_from_table(table: Mapping[str, Any], *, name: str, source: str) -> SensorDesign:
    """Validate the sections of a sensor file; `name` applies if the file has none.

    Messages name the file `source`, and paths in it are relative to its folder. Raises InputError
    as `load_sensor` does.
    """
    root = Section(table, "", source)
    return read(SensorDesign, root, name=root.text("name", default=name))


def _check_markers(design: SensorDesign, section: Section) -> None:
    """Check that markers do not touch each other and lie within the opening. Raises InputError."""
    frame = design.frame
    markers = design.markers
    for axis, count, pitch, size in (
        ("x", markers.columns, markers.pitch_x, frame.length),
        ("y", markers.rows, markers.pitch_y, frame.width),
    ):
        label = f"markers.pitch_{axis}_mm"
        if pitch <= 2 * markers.radius:
            message = f"{pitch / MM:g} lets markers of radius {markers.radius / MM:g} mm touch"
            raise section.fail(label, message)
        extent = (count - 1) * pitch + 2 * markers.radius
        if extent >= size and frame.outline is None:
            message = f"markers span {extent / MM:g} mm, more than the frame's {size / MM:g} mm"
            raise section.fail(label, message)
    if markers.count < _FEWEST_MARKERS and markers.frame is not None:
        message = (
            f"{markers.count} markers lie within the frame; at least {_FEWEST_MARKERS} are needed"
        )
        raise section.fail("markers", message)


def _check_depth(design: SensorDesign, section: Section) -> None:
    """Check that glass and chamber fit in front of the camera, and that the gas volume is
    positive."""
    chamber = design.chamber
    distance = design.camera.distance
    inner_face = design.glass.distance + design.glass.thickness
    if inner_face + chamber.depth > distance + 1e-9:
        message = (
            f"glass (to {inner_face / MM:g} mm) and chamber ({chamber.depth / MM:g} mm) "
            f"do not fit in {distance / MM:g} mm"
        )
        raise section.fail("camera.distance_mm", message)
    if design.chamber_volume_flat <= 0:
        volume = design.frame.area * chamber.depth
        message = (
            f"{chamber.extra_volume / ML:g} leaves no gas in the chamber of {volume / ML:.3g} mL"
        )
        raise section.fail("chamber.extra_volume_mL", message)


def _check_view(design: SensorDesign, section: Section) -> None:
    """Check that the camera's image contains every marker of the flat membrane."""
    outside = design.markers_outside_image()
    if not len(outside):
        return
    camera = design.camera
    positions = ", ".join(
        f"[{x / MM:.3g}, {y / MM:.3g}]"
        for x, y, _ in design.markers.p_SM[outside[:_NAMED_MAX]].tolist()
    )
    more = ", ..." if len(outside) > _NAMED_MAX else ""
    message = (
        f"{camera.distance / MM:g} leaves {len(outside)} of {design.markers.count} markers outside "
        f"the image of {camera.width} x {camera.height} pixels (at {positions}{more} mm): "
    )
    distance = _distance_in_view(design)
    if distance is None:
        remedy = "no larger distance shows all: check fx_px, fy_px, cx_px, cy_px and distortion"
    else:
        enough = math.ceil(10 * distance / MM) / 10
        remedy = f"all are inside from {enough:.1f} mm on, or with a shorter focal length"
    raise section.fail("camera.distance_mm", message + remedy)


def _distance_in_view(design: SensorDesign) -> float | None:
    """Return a distance of the camera, m, at which all markers are in the image; None: none is."""
    distance = design.camera.distance
    limit = 10 * distance
    while distance < limit:
        distance *= _FARTHER
        farther = replace(design, camera=replace(design.camera, distance=distance))
        if not len(farther.markers_outside_image()):
            return distance
    return None
