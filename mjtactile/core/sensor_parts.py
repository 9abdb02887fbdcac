"""Parts of a sensor: frame, membrane, markers, chamber, glass, camera, light. Each is a section of
a sensor file.

All quantities are SI internally. The file's keys carry the unit. Each field defines its unit and
range (`mjtactile.core.config_fields`). The format: docs/reference/sensor_files.md.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, fields
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.config_fields import (
    KPA,
    ML,
    ML_S_KPA,
    MM,
    entry,
    integer,
    number,
    read,
    write_fields,
)
from mjtactile.core.field_types import LensCoefficients, Pairs, Text
from mjtactile.core.lens import MODELS, PLUMB_BOB, Lens
from mjtactile.core.neo_hookean import Law, equibiaxial_stress
from mjtactile.core.outline import Outline, OutlineError
from mjtactile.core.toml import Section
from mjtactile.core.types import Array

# Unit of dimensionless numbers. It is an integer, so that an integer in a file stays an integer:
# fingerprints of sensor files (`mjtactile.core.calibration`) distinguish 600 from 600.0.
ONE = 1
_CLEAR = 0.5  # minimum distance of a marker from the outline, radii; a smaller one clips its image


class FrameShape(StrEnum):
    """Outlines that a frame's opening may have."""

    RECTANGLE = "rectangle"
    CIRCLE = "circle"
    ELLIPSE = "ellipse"
    ROUNDED = "rounded"
    POLYGON = "polygon"


_ROUND_CORNERS = (FrameShape.ROUNDED, FrameShape.POLYGON)
_SIDED = (FrameShape.RECTANGLE, FrameShape.ELLIPSE, FrameShape.ROUNDED)


@dataclass(frozen=True)
class Frame:
    """Rigid frame, m.

    Length and width are those of the rectangle, centered at the origin, that holds the opening. For
    a circle both equal its diameter.
    """

    length: float = number(
        "length_mm", 2, 500, MM, about="inner opening along x", only_if=("shape", _SIDED)
    )
    width: float = number(
        "width_mm", 2, 500, MM, about="inner opening along y", only_if=("shape", _SIDED)
    )
    rim: float = number("wall_mm", 0, 100, MM, default=0.003, about="width of the wall")
    shape: str = FrameShape.RECTANGLE
    corner_radius: float = number(
        "corner_radius_mm",
        0.5,
        200,
        MM,
        default=0.001,
        about="radius of each corner",
        only_if=("shape", _ROUND_CORNERS),
    )
    corners: tuple[tuple[float, float], ...] = entry(
        Pairs(
            key="corners_mm",
            units=(MM, MM),
            about="[x, y] of each corner before rounding, counter-clockwise, convex",
            only_if=("shape", (FrameShape.POLYGON,)),
        ),
        (),
    )

    @classmethod
    def from_section(cls, section: Section) -> Frame:
        """Read the frame according to its shape; a rectangle if none is given."""
        shape = FrameShape(section.text("shape", tuple(FrameShape), default="rectangle"))
        given: dict[str, Any] = {"shape": shape}
        if shape is FrameShape.CIRCLE:
            diameter = section.number("diameter_mm", 2, 500, MM)
            given |= {"length": diameter, "width": diameter}
        if shape is FrameShape.POLYGON:
            corners = tuple((MM * x, MM * y) for x, y in section.pairs("corners_mm"))
            sides = (2 * max((abs(at[k]) for at in corners), default=0.0) for k in (0, 1))
            given |= {"corners": corners} | dict(zip(("length", "width"), sides, strict=True))
        return read(cls, section, **given)

    def validate(self, section: Section) -> None:
        """Raise InputError if the corners are not convex, or the rounding does not fit."""
        try:
            _ = self.outline
        except OutlineError as error:
            raise section.fail(error.field, str(error)) from None

    @property
    def has_corners(self) -> bool:
        """True if the outline has rounded corners."""
        return self.shape in _ROUND_CORNERS

    @cached_property
    def outline(self) -> Outline | None:
        """The opening's outline; None of a rectangle."""
        half = (self.length / 2, self.width / 2)
        if self.shape == FrameShape.RECTANGLE:
            return None
        if self.shape in (FrameShape.CIRCLE, FrameShape.ELLIPSE):
            return Outline.ellipse(*half)
        if self.shape == FrameShape.ROUNDED:
            x, y = half
            return Outline.polygon([(-x, -y), (x, -y), (x, y), (-x, y)], self.corner_radius)
        return Outline.polygon(self.corners, self.corner_radius)

    def to_table(self) -> dict[str, Any]:
        """Return the file's table."""
        table = write_fields(self)
        if self.shape != FrameShape.RECTANGLE:
            table["shape"] = str(self.shape)
        if self.shape == FrameShape.CIRCLE:
            table["diameter_mm"] = self.length / MM
        return table

    @property
    def area(self) -> float:
        """Area of the opening, m^2."""
        return self.length * self.width if self.outline is None else self.outline.area

    def inside(self, xy: Array) -> Array:
        """Compute the distance (N,) m of positions (N, 2) m to the opening's edge; positive inside,
        negative outside."""
        if self.outline is not None:
            return self.outline.distance(xy)
        return (np.array([self.length, self.width]) / 2 - np.abs(xy)).min(axis=1)


@dataclass(frozen=True)
class Membrane:
    """Rubber membrane, SI: Pa, kg/m^3, m; `transmission` of its stress."""

    thickness: float = number("thickness_mm", 0.01, 5, MM, about="before stretching")
    young: float = number("young_MPa", 0.01, 1000, 1e6, about="Young's modulus")
    poisson: float = number("poisson_ratio", 0, 0.499, ONE, about="rubber: 0.45 to 0.49")
    density: float = number("density_kg_m3", 100, 20000, ONE, about="of the rubber")
    pre_stretch: float = number(
        "pre_stretch",
        0.9,
        2,
        ONE,
        default=1.0,
        about="mounted length over free length; below 0.95 refused",
    )
    friction: float = number(
        "friction", 0, 5, ONE, default=0.9, about="Coulomb friction coefficient"
    )
    law: Law = Law.NEO_HOOKEAN

    @property
    def pretension(self) -> float:
        """Tension per length T0, N/m, of the flat mounted membrane with equibiaxial stretch.

        The force per *mounted* length is h S with the second Piola-Kirchhoff stress S. The factor l
        of the deformation and the factor 1/l of the mounted length cancel.
        """
        return self.thickness * equibiaxial_stress(
            self.pre_stretch, self.young, self.poisson, self.law
        )


@dataclass(frozen=True)
class MarkerLayout:
    """Grid of rigid black circles on the inside, centered at the origin, m.

    Positions are those of the mounted, flat membrane. For a non-rectangular `frame`, only some
    circles remain. They lie at least `_CLEAR` radii within it.
    """

    rows: int = integer("rows", 2, 200, about="along y")
    columns: int = integer("columns", 2, 200, about="along x")
    pitch_x: float = number(
        "pitch_x_mm", 0.1, 200, MM, about="distance of centers along x, mounted and flat"
    )
    pitch_y: float = number("pitch_y_mm", 0.1, 200, MM, about="the same along y")
    radius: float = number("radius_mm", 0.05, 50, MM, about="radius of each black circle")

    frame: Frame | None = None

    @property
    def count(self) -> int:
        """Number of markers, N."""
        return len(self.p_SM)

    @cached_property
    def p_SM(self) -> Array:
        """Marker centres on the flat membrane, (N, 3) m in S; row by row, x fastest. Read-only."""
        x = (np.arange(self.columns) - (self.columns - 1) / 2) * self.pitch_x
        y = (np.arange(self.rows) - (self.rows - 1) / 2) * self.pitch_y
        grid_x, grid_y = np.meshgrid(x, y)
        p_SM = np.column_stack([grid_x.ravel(), grid_y.ravel(), np.zeros(grid_x.size)])
        if self.frame is not None:
            p_SM = p_SM[self.frame.inside(p_SM[:, :2]) > (1 + _CLEAR) * self.radius]
        p_SM.flags.writeable = False
        return p_SM


@dataclass(frozen=True)
class Chamber:
    """Sealed space behind the flat membrane, SI: m, Pa, K, s, m^3/(s Pa) of volume flow, m^3."""

    depth: float = number("depth_mm", 0.1, 500, MM, about="from the flat membrane to the glass")
    polytropic_exponent: float = number(
        "polytropic_exponent",
        1,
        1.7,
        ONE,
        default=1.0,
        about="gamma of p V^gamma: 1 isothermal, 1.4 air without heat exchange",
    )
    supply_gauge: float = number(
        "supply_pressure_kPa", -50, 100, KPA, default=1000.0, about="working pressure, gauge"
    )
    ambient: float = number("ambient_kPa", 1, 1000, KPA, default=101325.0, about="absolute")
    temperature: float = number(
        "temperature_K", 200, 400, ONE, default=293.15, about="of gas and walls"
    )
    heat_exchange: float = number(
        "thermal_time_constant_s",
        1e-3,
        1e6,
        ONE,
        default=math.inf,
        about="heat exchange of gas and walls; 0.5-2 for a few mm of air",
    )
    valve_conductance: float = number(
        "valve_mL_s_kPa",
        1e-3,
        1e6,
        ML_S_KPA,
        default=math.inf,
        about="flow through the open valve per kPa",
    )
    leak_conductance: float = number(
        "leak_mL_s_kPa", 0, 1e6, ML_S_KPA, default=0.0, about="flow per kPa through a leak"
    )
    extra_volume: float = number(
        "extra_volume_mL",
        -1e4,
        1e4,
        ML,
        default=0.0,
        about=(
            "gas volume in addition to that between opening and glass, such as the hose; "
            "negative where the walls slope inward"
        ),
    )


@dataclass(frozen=True)
class Glass:
    """Flat glass normal to the camera's axis, lengths in m."""

    thickness: float = number("thickness_mm", 0, 50, MM, about="0: no glass")
    refractive_index: float = number(
        "refractive_index", 1, 3, ONE, about="glass 1.52, acrylic 1.49"
    )
    distance: float = number(
        "distance_mm", 0, 1000, MM, about="from the camera center to the glass"
    )


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics of a camera, pixels."""

    width: int = integer("width_px", 16, 8192, about="size of the image")
    height: int = integer("height_px", 16, 8192, about="size of the image")
    fx: float = number("fx_px", 10, 1e5, ONE, about="focal length along u")
    fy: float = number("fy_px", 10, 1e5, ONE, about="focal length along v")
    cx: float = number(
        "cx_px", -8192, 16384, ONE, about="principal point along u; the top-left pixel is (0, 0)"
    )
    cy: float = number("cy_px", -8192, 16384, ONE, about="principal point along v")
    distortion: tuple[float, ...] = entry(
        LensCoefficients(
            key="distortion",
            low=-1000,
            high=1000,
            about=(
                "in the order of OpenCV and ROS: "
                + "; ".join(f"{', '.join(m.coefficients)} ({name})" for name, m in MODELS.items())
            ),
        ),
        (),
    )
    _: KW_ONLY
    distortion_model: str = entry(
        Text(
            key="distortion_model",
            choices=tuple(MODELS),
            about="lens model, as in ROS; equidistant is a fisheye",
        ),
        PLUMB_BOB,
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "distortion", self.lens.coefficients)

    @cached_property
    def lens(self) -> Lens:
        """Lens model with its coefficients."""
        return Lens(self.distortion_model, tuple(self.distortion))

    @property
    def K(self) -> Array:
        """Intrinsic matrix (3, 3), pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def half_view(self) -> Array:
        """Tangents (2,) of half the field of view along u and v, through the lens.

        Without distortion they are width/(2 fx) and height/(2 fy), which also apply where the lens
        model folds over within the image.
        """
        edge = np.diag([self.width / (2 * self.fx), self.height / (2 * self.fy)])
        ideal = self.lens.undistort(edge)
        return np.diagonal(np.where(np.isfinite(ideal), ideal, edge)).copy()

    def size_mismatch(self, pixels: NDArray[Any], owner: str = "the camera") -> str:
        """Compare the size of an image with that of this camera.

        Args:
            pixels: Image (H, W) or (H, W, channels).
            owner: Name of this camera in the message.

        Returns:
            A clause that states both sizes; empty if they are equal.
        """
        height, width = pixels.shape[:2]
        if (width, height) == (self.width, self.height):
            return ""
        size = f"{self.width} x {self.height}"
        return f"the image has {width} x {height} pixels, but {owner} has {size}"

    @property
    def intrinsics(self) -> dict[str, Any]:
        """Intrinsic parameters by name, without the fields of a subclass."""
        return {field.name: getattr(self, field.name) for field in fields(Pinhole)}


@dataclass(frozen=True, kw_only=True)
class CameraDesign(Pinhole):
    """Camera behind the glass, looking along +z of S; m, Hz."""

    distance: float = number(
        "distance_mm", 1, 2000, MM, about="from the camera center to the flat membrane"
    )
    rate: float = number(
        "rate_Hz", 0.1, 2000, ONE, default=30.0, about="images and control cycles per second"
    )
    blur_px: float = number(
        "blur_px",
        0,
        20,
        ONE,
        default=0.7,
        about="sd of the image blur; start value of the edge correction",
    )
    noise_dn: float = number(
        "noise_DN", 0, 100, ONE, default=2.0, about="pixel noise (sd) in gray levels of 8 bit"
    )

    @property
    def p_SC(self) -> Array:
        """Camera centre in S. The camera's axes are parallel to those of S (R_SC = I)."""
        return np.array([0.0, 0.0, -self.distance])


@dataclass(frozen=True)
class Leds:
    """LEDs on a ring around the camera, m, and the grey levels (0-255) under them."""

    count: int = integer("count", 0, 1000, default=4, about="LEDs on a ring around the camera")
    ring_radius: float = number(
        "ring_radius_mm", 0, 500, MM, default=0.012, about="radius of the LED ring"
    )
    membrane_dn: float = number(
        "membrane_DN", 0, 255, ONE, default=185.0, about="gray level of the membrane"
    )
    marker_dn: float = number(
        "marker_DN", 0, 255, ONE, default=40.0, about="gray level of a marker"
    )
    vignetting: float = number(
        "vignetting", 0, 1, ONE, default=0.25, about="fraction of light lost at the image corners"
    )
