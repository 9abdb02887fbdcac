"""`SensorDesign`: what a sensor is made of, read from a TOML file and checked. Used by the
simulator *and* by sensing.

Every quantity is SI inside. The file's keys carry the unit; the table `FIELDS` is the one place
that knows both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core import resources
from mjtactile.core.errors import InputError
from mjtactile.core.rubber import Law, equibiaxial_stress
from mjtactile.core.toml import Section, read_toml
from mjtactile.core.types import Array


@dataclass(frozen=True)
class Frame:
    """Rigid frame: inner `length` (x) and `width` (y), `rim` width of its wall around the opening,
    m; `shape` "rectangle", or "circle" with its diameter for both. Sensing handles rectangles only,
    and refuses a circle."""

    length: float
    width: float
    rim: float = 0.003
    shape: str = "rectangle"

    @property
    def area(self) -> float:
        """Area of the opening, m^2."""
        return self.length * self.width * (math.pi / 4 if self.shape == "circle" else 1.0)


@dataclass(frozen=True)
class Membrane:
    """Rubber sheet: `thickness` m before stretching, `young` Pa, `poisson`, `density` kg/m^3,
    `pre_stretch` (1 = none), `friction` coefficient of its outside, `law` of its stress."""

    thickness: float
    young: float
    poisson: float
    density: float
    pre_stretch: float = 1.0
    friction: float = 0.9
    law: Law = Law.NEO_HOOKEAN

    @property
    def pretension(self) -> float:
        """Tension per length T0, N/m, of the flat mounted sheet, stretched alike in all directions.

        The force per *mounted* length is h S with the second Piola-Kirchhoff stress S (the factor l
        of the deformation and the factor 1/l of the mounted length cancel).
        """
        return self.thickness * equibiaxial_stress(
            self.pre_stretch, self.young, self.poisson, self.law
        )


@dataclass(frozen=True)
class MarkerLayout:
    """Rigid black circles on the inside: `rows` x `columns` at `pitch_x`, `pitch_y` m about the
    centre, `radius` m.

    Positions are those of the mounted, flat membrane.
    """

    rows: int
    columns: int
    pitch_x: float
    pitch_y: float
    radius: float

    @property
    def count(self) -> int:
        return self.rows * self.columns

    @cached_property
    def p_SM(self) -> Array:
        """Marker centres on the flat membrane, (N, 3) m in S; row by row, x fastest. Read-only."""
        x = (np.arange(self.columns) - (self.columns - 1) / 2) * self.pitch_x
        y = (np.arange(self.rows) - (self.rows - 1) / 2) * self.pitch_y
        grid_x, grid_y = np.meshgrid(x, y)
        p_SM = np.column_stack([grid_x.ravel(), grid_y.ravel(), np.zeros(self.count)])
        p_SM.flags.writeable = False
        return p_SM


@dataclass(frozen=True)
class Chamber:
    """Sealed space of `depth` m behind the flat membrane; `heat_ratio` is gamma of the gas law p
    V^gamma (1 = isothermal); `supply_gauge` Pa that the valve connects to; `ambient` Pa absolute;
    `temperature` K of gas and walls.

    `heat_exchange` s is the time constant with which the gas takes the walls' temperature
    (infinite: never, so that gamma stays; a few mm of air need 0.5-2 s). `valve_conductance` and
    `leak_conductance`, m^3/(s Pa), are volume flow per pressure difference of the open valve
    (infinite: the pressure follows at once) and of a hole to ambient. `extra_volume` m^3 is gas
    that is not between opening and glass: a hose's, or less than none where walls slope in.
    """

    depth: float
    heat_ratio: float = 1.0
    supply_gauge: float = 1000.0
    ambient: float = 101325.0
    temperature: float = 293.15
    heat_exchange: float = math.inf
    valve_conductance: float = math.inf
    leak_conductance: float = 0.0
    extra_volume: float = 0.0


@dataclass(frozen=True)
class Glass:
    """Flat pane normal to the camera's axis: `thickness` m (0 = no glass), `refractive_index`,
    `distance` m from the camera centre to its near face."""

    thickness: float
    refractive_index: float
    distance: float


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics of a camera: size, focal lengths and centre in pixels, plumb_bob `distortion` (k1,
    k2, p1, p2, k3)."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def K(self) -> Array:
        """Intrinsic matrix (3, 3), pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def intrinsics(self) -> dict[str, Any]:
        """These values by name: of whatever else a subclass knows, nothing."""
        return {field.name: getattr(self, field.name) for field in fields(Pinhole)}


@dataclass(frozen=True)
class CameraDesign(Pinhole):
    """Camera behind the glass, looking along +z of S: `distance` m from its centre to the flat
    membrane, `rate` Hz, `blur_px` (Gaussian sd) and `noise_dn` (sd at 8 bit) of its images."""

    distance: float = field(kw_only=True)
    rate: float = 30.0
    blur_px: float = 0.7
    noise_dn: float = 2.0

    @property
    def p_SC(self) -> Array:
        """Camera centre in S; the camera's axes are parallel to those of S (R_SC = I)."""
        return np.array([0.0, 0.0, -self.distance])


@dataclass(frozen=True)
class Leds:
    """`count` LEDs on a ring of `ring_radius` m around the camera; `membrane_dn`, `marker_dn` are
    the grey levels (0-255) of the white membrane and the black markers under them; `falloff` is the
    share of light lost at the corners."""

    count: int = 4
    ring_radius: float = 0.012
    membrane_dn: float = 185.0
    marker_dn: float = 40.0
    falloff: float = 0.25


@dataclass(frozen=True)
class SensorDesign:
    """A whole sensor. Build one with `load_sensor`, or directly with SI values. `calibration` is
    the file that a finger's own sensor file names for what was measured of it (None: it names
    none)."""

    name: str
    frame: Frame
    membrane: Membrane
    markers: MarkerLayout
    chamber: Chamber
    glass: Glass
    camera: CameraDesign
    leds: Leds = field(default_factory=Leds)
    calibration: Path | None = field(default=None, compare=False)

    def require_rectangle(self, who: str) -> None:
        """Raise InputError where the frame is not what `who` is made for."""
        if self.frame.shape != "rectangle":
            raise InputError(
                f"{self.frame.shape!r} can be simulated, but {who} handles rectangles only",
                source=self.name,
                field="frame.shape",
                choices=["rectangle"],
            )

    @property
    def pane_thickness_apparent(self) -> float:
        """Depth by which the glass brings the scene nearer on the camera's axis, t (1 - 1/n), m."""
        return self.glass.thickness * (1 - 1 / self.glass.refractive_index)

    @property
    def chamber_volume_flat(self) -> float:
        """Gas volume with a flat membrane, m^3."""
        return self.frame.area * self.chamber.depth + self.chamber.extra_volume


# One row a field: key in the file, attribute, SI units in one unit of the file (0: a whole number),
# lowest and highest value.
_MM = 1e-3
_KPA = 1e3
_ML = 1e-6
_ML_S_KPA = 1e-9
_Row = tuple[str, str, float, float, float]
FIELDS: dict[str, tuple[type, tuple[_Row, ...]]] = {
    "frame": (
        Frame,
        (
            ("length_mm", "length", _MM, 2, 500),
            ("width_mm", "width", _MM, 2, 500),
            ("rim_mm", "rim", _MM, 0, 100),
        ),
    ),
    "membrane": (
        Membrane,
        (
            ("thickness_mm", "thickness", _MM, 0.01, 5),
            ("young_MPa", "young", 1e6, 0.01, 1000),
            ("poisson_ratio", "poisson", 1, 0, 0.499),
            ("density_kg_m3", "density", 1, 100, 20000),
            ("pre_stretch", "pre_stretch", 1, 0.9, 2),
            ("friction", "friction", 1, 0, 5),
        ),
    ),
    "markers": (
        MarkerLayout,
        (
            ("rows", "rows", 0, 2, 200),
            ("columns", "columns", 0, 2, 200),
            ("pitch_x_mm", "pitch_x", _MM, 0.1, 200),
            ("pitch_y_mm", "pitch_y", _MM, 0.1, 200),
            ("radius_mm", "radius", _MM, 0.05, 50),
        ),
    ),
    "chamber": (
        Chamber,
        (
            ("depth_mm", "depth", _MM, 0.1, 500),
            ("heat_ratio", "heat_ratio", 1, 1, 1.7),
            ("supply_gauge_kPa", "supply_gauge", _KPA, -50, 100),
            ("ambient_kPa", "ambient", _KPA, 1, 1000),
            ("temperature_K", "temperature", 1, 200, 400),
            ("heat_exchange_s", "heat_exchange", 1, 1e-3, 1e6),
            ("valve_mL_s_kPa", "valve_conductance", _ML_S_KPA, 1e-3, 1e6),
            ("leak_mL_s_kPa", "leak_conductance", _ML_S_KPA, 0, 1e6),
            ("extra_volume_mL", "extra_volume", _ML, -1e4, 1e4),
        ),
    ),
    "glass": (
        Glass,
        (
            ("thickness_mm", "thickness", _MM, 0, 50),
            ("refractive_index", "refractive_index", 1, 1, 3),
            ("distance_mm", "distance", _MM, 0, 1000),
        ),
    ),
    "camera": (
        CameraDesign,
        (
            ("distance_mm", "distance", _MM, 1, 2000),
            ("width_px", "width", 0, 16, 8192),
            ("height_px", "height", 0, 16, 8192),
            ("fx_px", "fx", 1, 10, 1e5),
            ("fy_px", "fy", 1, 10, 1e5),
            ("cx_px", "cx", 1, -8192, 16384),
            ("cy_px", "cy", 1, -8192, 16384),
            ("distortion", "distortion", 1, -100, 100),
            ("rate_Hz", "rate", 1, 0.1, 2000),
            ("blur_px", "blur_px", 1, 0, 20),
            ("noise_DN", "noise_dn", 1, 0, 100),
        ),
    ),
    "leds": (
        Leds,
        (
            ("count", "count", 0, 0, 1000),
            ("ring_radius_mm", "ring_radius", _MM, 0, 500),
            ("membrane_DN", "membrane_dn", 1, 0, 255),
            ("marker_DN", "marker_dn", 1, 0, 255),
            ("falloff", "falloff", 1, 0, 1),
        ),
    ),
}
SHAPES = ("rectangle", "circle")


def load_sensor(name_or_path: str | Path | SensorDesign) -> SensorDesign:
    """Read a sensor by shipped name or from a TOML file.

    Raises InputError naming file, field, value and valid choices for a missing, misspelt, negative,
    non-finite or wrong-unit field.
    """
    if isinstance(name_or_path, SensorDesign):
        return name_or_path
    path = resources.find(name_or_path, "models/sensors", ".toml")
    return sensor_from_table(read_toml(path), name=path.stem, source=str(path))


def sensor_from_table(table: Mapping[str, Any], *, name: str, source: str) -> SensorDesign:
    """Validate a parsed TOML table; see `load_sensor`."""
    root = Section(table, "", source)
    name = root.text("name", default=name)
    calibration = root.text("calibration", default=None)
    frame = _frame(root.section("frame"))
    leds = root.optional("leds")
    parts = {
        key: _part(root.section(key), *FIELDS[key])
        for key in FIELDS
        if key not in ("frame", "leds")
    }
    root.done()
    design = SensorDesign(
        name,
        frame,
        **parts,
        leds=_part(leds, *FIELDS["leds"]) if leds else Leds(),
        calibration=None if calibration is None else Path(source).parent / calibration,
    )
    _check_geometry(design, source)
    return design


def _part(section: Section, kind: type, rows: tuple[_Row, ...]) -> Any:
    values = {}
    for key, attribute, scale, low, high in rows:
        default = getattr(kind, attribute, ...)  # where the dataclass has one
        if attribute == "distortion":
            values[attribute] = section.numbers(
                key, ("k1", "k2", "p1", "p2", "k3"), low, high, default=default
            )
        elif scale == 0:
            values[attribute] = section.whole(key, int(low), int(high), default)
        else:
            values[attribute] = section.number(key, low, high, scale, default)
    section.done()
    return kind(**values)


def _frame(section: Section) -> Frame:
    """A rectangle by length and width (`shape` may be left out), or a circle by its diameter."""
    shape = section.text("shape", SHAPES, default="rectangle")
    if shape == "rectangle":
        return _part(section, *FIELDS["frame"])
    diameter = section.number("diameter_mm", 2, 500, _MM)
    circle = Frame(
        diameter, diameter, section.number("rim_mm", 0, 100, _MM, default=Frame.rim), shape
    )
    section.done()
    return circle


def _check_geometry(design: SensorDesign, source: str) -> None:
    """Physical preconditions that join several fields."""
    frame = design.frame
    markers = design.markers
    camera = design.camera
    glass = design.glass
    for axis, count, pitch, size in (
        ("x", markers.columns, markers.pitch_x, frame.length),
        ("y", markers.rows, markers.pitch_y, frame.width),
    ):
        label = f"markers.pitch_{axis}_mm"
        if pitch <= 2 * markers.radius:
            raise InputError(
                f"{pitch / _MM:g} lets markers of radius {markers.radius / _MM:g} mm touch",
                source=source,
                field=label,
            )
        extent = (count - 1) * pitch + 2 * markers.radius
        if extent >= size:
            raise InputError(
                f"markers span {extent / _MM:g} mm, more than the frame's {size / _MM:g} mm",
                source=source,
                field=label,
            )
    if frame.shape == "circle":
        reach = float(np.linalg.norm(markers.p_SM, axis=1).max()) + markers.radius
        if reach >= frame.length / 2:
            raise InputError(
                f"markers reach {reach / _MM:g} mm from the middle, out of the frame's radius "
                "of "
                f"{frame.length / 2 / _MM:g} mm",
                source=source,
                field="markers",
            )
    inner_face = glass.distance + glass.thickness
    if inner_face + design.chamber.depth > camera.distance + 1e-9:
        raise InputError(
            f"glass (to {inner_face / _MM:g} mm) and chamber ({design.chamber.depth / _MM:g} "
            "mm) do not fit in "
            f"{camera.distance / _MM:g} mm",
            source=source,
            field="camera.distance_mm",
        )
    if design.chamber_volume_flat <= 0:
        raise InputError(
            f"{design.chamber.extra_volume / _ML:g} leaves no gas of the chamber's "
            f"{frame.area * design.chamber.depth / _ML:.3g} "
            "mL",
            source=source,
            field="chamber.extra_volume_mL",
        )
    if design.leds.marker_dn >= design.leds.membrane_dn:
        raise InputError(
            "markers must be darker than the membrane", source=source, field="leds.marker_DN"
        )
