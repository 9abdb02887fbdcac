"""Camera hardware that exists: its lens and focus stay, and the designs fit to it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.lens import PLUMB_BOB
from mjtactile.core.optics import Camera
from mjtactile.fabrication.housing_layout import Layout
from mjtactile.fabrication.manufacturability import check_all, limits_of
from mjtactile.fabrication.purchased_parts import Hardware

_STEP = 0.5e-3  # search step of the chamber's depth, m
_SHALLOWEST = 5e-3  # chamber depth, m


@dataclass(frozen=True)
class GivenHardware:
    """Parts of the camera that a search does not change.

    Attributes:
        lens: True if focal lengths, principal point and distortion stay.
        focus: True if the camera's distance from the membrane stays.
    """

    lens: bool = False
    focus: bool = False


ALL_FREE = GivenHardware()


def with_camera_file(design: SensorDesign, camera: Camera) -> SensorDesign:
    """Return the sensor with the lens and image size of a camera file.

    Args:
        design: The sensor.
        camera: Content of the file; its glass is ignored.

    Returns:
        The sensor, without a check that the markers are in the image.
    """
    intrinsics = {name: getattr(camera, name) for name in design.camera.intrinsics}
    return replace(design, camera=replace(design.camera, **intrinsics))


def with_field_of_view(design: SensorDesign, angle: float) -> SensorDesign:
    """Return the sensor with a lens without distortion, by its horizontal field of view.

    Args:
        design: The sensor.
        angle: Horizontal field of view, rad.

    Returns:
        The sensor, without a check that the markers are in the image.
    """
    camera = design.camera
    focal = camera.width / (2 * math.tan(angle / 2))
    held = replace(
        camera,
        fx=focal,
        fy=focal,
        cx=(camera.width - 1) / 2,
        cy=(camera.height - 1) / 2,
        distortion=(),
        distortion_model=PLUMB_BOB,
    )
    return replace(design, camera=held)


def with_focus(design: SensorDesign, focus: float) -> SensorDesign:
    """Return the sensor with the flat membrane in the focus of its camera.

    The glass brings the membrane optically closer.

    Args:
        design: The sensor.
        focus: Distance from the camera center to the sharp plane in air, m.

    Returns:
        The sensor.

    Raises:
        InputError: Chamber and glass do not fit.
    """
    return with_distance(design, focus + design.apparent_glass_thickness, "--focus-mm")


def with_distance(design: SensorDesign, distance: float, field: str) -> SensorDesign:
    """Return the sensor with another distance from the camera to the flat membrane, m.

    The glass keeps its thickness. The chamber keeps its depth if camera, glass and nuts fit behind
    it; otherwise it is less deep.

    Raises:
        InputError: They do not fit; it names the `field`.
    """
    depth = design.chamber.depth
    while depth > _SHALLOWEST:
        behind = depth + design.glass.thickness
        fitting = replace(
            design,
            camera=replace(design.camera, distance=distance),
            glass=replace(design.glass, distance=max(distance - behind, 0.0)),
            chamber=replace(design.chamber, depth=depth),
        )
        if distance >= behind and _camera_fits(fitting):
            return fitting
        depth = round(depth - _STEP, 6)
    raise InputError(
        f"{1e3 * (distance - design.apparent_glass_thickness):.3g} leaves no room for chamber, "
        "glass and camera in the housing of `mjtactile fabricate`",
        source=design.name,
        field=field,
    )


def _camera_fits(design: SensorDesign) -> bool:
    """Return True if the housing has room between glass and camera."""
    layout = Layout(design, Hardware())
    limits = (*limits_of(design, layout.hardware), *layout.limits())
    try:
        check_all((limit for limit in limits if limit.field == "glass.distance_mm"), design.name)
    except InputError:
        return False
    return True
