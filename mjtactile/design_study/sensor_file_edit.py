"""A sensor file written from its values, and the changes that a study makes to them."""

from __future__ import annotations

import tomllib
from dataclasses import replace

from mjtactile.core.config_fields import write_fields
from mjtactile.core.design import SensorDesign, sensor_from_table
from mjtactile.core.errors import InputError
from mjtactile.core.toml import toml_text

_DIGITS = 10  # digits of numbers in a sensor file


def sensor_text(design: SensorDesign, head: str = "") -> str:
    """Return a sensor in file format.

    Args:
        design: The sensor.
        head: Comment at the top.

    Returns:
        TOML that `load_sensor` reads.
    """
    table = write_fields(design)
    table.pop("calibration", None)  # it belongs to an as-built sensor; this is a design
    lines = [*head.splitlines(), "Units are in the key names."]
    return "".join(f"# {line}\n" for line in lines) + toml_text(table, digits=_DIGITS)


def rebuilt(design: SensorDesign) -> SensorDesign:
    """Return the sensor that results from the file of a changed design.

    Args:
        design: With whatever values.

    Returns:
        The sensor of its file.

    Raises:
        InputError: As `load_sensor`.
    """
    table = tomllib.loads(sensor_text(design))
    return sensor_from_table(table, name=design.name, source=design.name)


def with_markers(
    design: SensorDesign, rows: int, columns: int, extent: tuple[float, float], fraction: float
) -> SensorDesign:
    """Return the same sensor with other markers.

    Args:
        design: The sensor.
        rows: Number along y.
        columns: Number along x.
        extent: Distance between the outermost centers along x and y, m.
        fraction: Marker radius as a fraction of the smaller pitch.

    Returns:
        The sensor.
    """
    pitch_x = extent[0] / (columns - 1)
    pitch_y = extent[1] / (rows - 1)
    radius = fraction * min(pitch_x, pitch_y)
    markers = replace(
        design.markers, rows=rows, columns=columns, pitch_x=pitch_x, pitch_y=pitch_y, radius=radius
    )
    return replace(design, markers=markers)


def extent_of(design: SensorDesign) -> tuple[float, float]:
    """Return the distance of the outermost markers along x and y, m."""
    markers = design.markers
    return (markers.columns - 1) * markers.pitch_x, (markers.rows - 1) * markers.pitch_y


def radius_fraction(design: SensorDesign) -> float:
    """Return a marker's radius as a fraction of the smaller pitch."""
    return design.markers.radius / min(design.markers.pitch_x, design.markers.pitch_y)


def scaled_lens(design: SensorDesign, factor: float) -> SensorDesign:
    """Return the same sensor with focal lengths times `factor`."""
    camera = design.camera
    return replace(design, camera=replace(camera, fx=factor * camera.fx, fy=factor * camera.fy))


def scaled_pixels(design: SensorDesign, factor: float) -> SensorDesign:
    """Scale the pixels by `factor` per side, at the same view, blur and noise per pixel."""
    camera = design.camera
    width, height = (round(factor * side) for side in (camera.width, camera.height))
    by_x = width / camera.width
    by_y = height / camera.height
    return replace(
        design,
        camera=replace(
            camera,
            width=width,
            height=height,
            fx=by_x * camera.fx,
            fy=by_y * camera.fy,
            cx=by_x * (camera.cx + 0.5) - 0.5,
            cy=by_y * (camera.cy + 0.5) - 0.5,
        ),
    )


def with_frame(design: SensorDesign, length: float, width: float) -> SensorDesign:
    """Change the opening, m, at the same marker density and distance from the frame."""
    frame = design.frame
    markers = design.markers
    extent = extent_of(design)
    wider = (length - frame.length, width - frame.width)
    counts = (
        max(2, round(more / pitch) + many)
        for more, pitch, many in zip(
            wider, (markers.pitch_x, markers.pitch_y), (markers.columns, markers.rows), strict=True
        )
    )
    columns, rows = counts
    requested = (extent[0] + wider[0], extent[1] + wider[1])
    if min(requested) <= 0:
        raise InputError("leaves no room for the markers", source=design.name, field="--frame-mm")
    changed = replace(design, frame=replace(frame, length=length, width=width))
    return with_markers(changed, rows, columns, requested, radius_fraction(design))


def with_picture(design: SensorDesign, width: int, height: int) -> SensorDesign:
    """Change the image size, at the same lens and field of view along x."""
    camera = design.camera
    scaled = scaled_pixels(design, width / camera.width).camera
    center = height / camera.height * (camera.cy + 0.5) - 0.5
    return replace(design, camera=replace(scaled, width=width, height=height, cy=center))
