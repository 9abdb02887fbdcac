"""Tactile estimates of one sensor: the membrane's shape, its forces, contact, slip."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.status import OK, Status
from mjtactile.core.types.arrays import Array, fixed, freeze, keep_status
from mjtactile.core.types.contact_shape import ContactShape
from mjtactile.core.types.vision import NO_PIXELS, CameraDrift, Image, Markers

_NO_FORCE = fixed(np.full(3, np.nan))
_NO_OUTLINE = fixed(np.zeros((0, 2)))
_NO_AXES = fixed(np.full(2, np.nan))
_NO_INTERVAL = fixed(np.full(2, np.nan))


@dataclass(frozen=True, eq=False)
class Surface:
    """The membrane's shape in S, as heights over a Cartesian grid.

    Attributes:
        x: Grid positions (nx,) m, increasing.
        y: Grid positions (ny,) m, increasing.
        z: Heights (ny, nx) m, zero on the frame, positive outward.
        area: Area of the curved surface, m^2.
        volume: Volume between surface and the frame's plane, m^3, positive outward.
        area_sd: Standard deviation of the area, m^2.
        volume_sd: Standard deviation of the volume, m^3.
        status: "ok", or the reason why the shape is invalid.
    """

    x: Array
    y: Array
    z: Array
    area: float
    volume: float
    area_sd: float
    volume_sd: float
    status: Status = OK

    def __post_init__(self) -> None:
        nx = len(freeze(self, "x", self.x, (None,)))
        ny = len(freeze(self, "y", self.y, (None,)))
        freeze(self, "z", self.z, (ny, nx))
        keep_status(self)


@dataclass(frozen=True, eq=False)
class Traction:
    """External force on the membrane, in S. An indenting force has a negative z.

    Attributes:
        x: Grid nodes along x (nx,) m.
        y: Grid nodes along y (ny,) m.
        force: Force on each node (ny, nx, 3) N.
        wrench: Net force, N, and torque about the origin of S, N m, (6,).
        wrench_cov: Covariance (6, 6) of the wrench.
        gauge_pressure: Estimated gauge pressure in the chamber, Pa.
        method: Name of the estimator.
        status: "ok", or the reason why it is invalid.
    """

    x: Array
    y: Array
    force: Array
    wrench: Array
    wrench_cov: Array
    gauge_pressure: float
    method: str
    status: Status = OK

    def __post_init__(self) -> None:
        nx = len(freeze(self, "x", self.x, (None,)))
        ny = len(freeze(self, "y", self.y, (None,)))
        freeze(self, "force", self.force, (ny, nx, 3))
        freeze(self, "wrench", self.wrench, (6,))
        freeze(self, "wrench_cov", self.wrench_cov, (6, 6))
        keep_status(self)


@dataclass(frozen=True, eq=False)
class Contact:
    """Contact region: all contacts together, or one patch.

    Attributes:
        touching: True if there is contact. If not, `area` is 0 and `centroid` NaN.
        area: Area of the membrane in contact, m^2.
        area_interval: Interval (2,), m^2, that contains the area with 68 % probability.
        centroid: Center of the contact (2,) m in S.
        depth: Maximum indentation relative to the rest shape, m.
        mask: Nodes of the traction grid in contact (ny, nx).
        status: "ok", or the reason why it is invalid.
        force: Force on a single patch (3,) N, S.
        outline: Border of a single patch as a closed polygon (P, 2) m.
        semi_axes: Semi-axes of the ellipse with the same second moments (2,) m, the larger first.
        angle: Angle of the larger one from x, rad.
        area_source: Source of `area` and `outline`: the "nodal" estimate of pressures, or the
            family of the estimated shape (`Touch.shape`).
    """

    touching: bool
    area: float
    centroid: Array
    depth: float
    mask: NDArray[np.bool_]
    status: Status = OK
    force: Array = field(default_factory=lambda: _NO_FORCE)
    outline: Array = field(default_factory=lambda: _NO_OUTLINE)
    semi_axes: Array = field(default_factory=lambda: _NO_AXES)
    angle: float = np.nan
    area_source: str = "nodal"
    area_interval: Array = field(default_factory=lambda: _NO_INTERVAL)

    def __post_init__(self) -> None:
        freeze(self, "centroid", self.centroid, (2,))
        freeze(self, "mask", self.mask, (None, None), np.bool_)
        freeze(self, "force", self.force, (3,))
        freeze(self, "outline", self.outline, (None, 2))
        freeze(self, "semi_axes", self.semi_axes, (2,))
        freeze(self, "area_interval", self.area_interval, (2,))
        keep_status(self)


SlipState = Literal["none", "sticking", "incipient", "slipping", "unknown"]
SLIP_STATES: tuple[str, ...] = get_args(SlipState)


@dataclass(frozen=True, eq=False)
class Slip:
    """Slip of the object on the membrane.

    Attributes:
        state: One of SLIP_STATES. "none": no contact; "slipping": the whole contact slides,
            according to the images, regardless of friction; "incipient": the friction is nearly
            exhausted, as far as the coefficient is known.
        velocity: Velocity (2,) m/s of the object over the membrane, S; noise while it sticks. It is
            that of the estimated shape if available, else that of the pressure center.
        distance: Slip distance since the start of the contact, m.
        stick_ratio: Fraction of the contact with shear below the friction limit.
        status: "ok", or the reason why it is unknown.
    """

    state: SlipState
    velocity: Array
    distance: float
    stick_ratio: float
    status: Status = OK

    def __post_init__(self) -> None:
        freeze(self, "velocity", self.velocity, (2,))
        keep_status(self)


@dataclass(frozen=True, eq=False)
class Touch:
    """Tactile estimate of one sensor from one image.

    Attributes:
        time: Capture time of the image, s.
        age: Time from the capture until now, s.
        force_normal: Normal force, N, positive for indentation; NaN when `status` is not "ok":
            unknown is not zero.
        force_normal_sd: Its standard deviation, N.
        touching: True if there is contact.
        contact: All contacts together.
        traction: Forces over the membrane, and the net wrench.
        surface: The membrane's shape.
        markers: The detected markers.
        status: "ok", or the reason why the force is unknown.
        patches: Separate contact patches, the strongest first.
        slip: Slip of the object.
        shape: Contact shape; None without images, and from `SensingPipeline.step`.
        camera: Drift of the camera by the fiducials; None: there are none, or too few were
            detected.
    """

    time: float
    age: float
    force_normal: float
    force_normal_sd: float
    touching: bool
    contact: Contact | None = None
    traction: Traction | None = None
    surface: Surface | None = None
    markers: Markers | None = None
    status: Status = OK
    patches: tuple[Contact, ...] = ()
    slip: Slip | None = None
    shape: ContactShape | None = None
    camera: CameraDrift | None = None

    def __post_init__(self) -> None:
        keep_status(self)


@dataclass(frozen=True, eq=False)
class SyntheticTouch(Image):
    """Replacement for an image without pixels: it holds the `touch` that would be estimated."""

    touch: Touch | None = None

    @classmethod
    def of(cls, touch: Touch) -> SyntheticTouch:
        """Return the touch in place of an image of its time."""
        return cls(NO_PIXELS, touch.time, touch)
