"""What one sensor feels: the membrane's shape, forces over it, contact, slip."""

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


@dataclass(frozen=True, eq=False)
class Surface:
    """The membrane's shape in S, as heights over a Cartesian grid.

    Attributes:
        x: (nx,) m, increasing.
        y: (ny,) m, increasing.
        z: (ny, nx) m, zero on the frame, positive outward.
        area: m^2 of the curved surface.
        volume: m^3 between it and the frame's plane, positive outward.
        area_sd: Standard deviation of the area, m^2.
        volume_sd: Standard deviation of the volume, m^3.
        status: "ok", or why the shape is not to be trusted.
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
    """Force that the outside world exerts on the membrane, in S. A press has a negative z.

    Attributes:
        x: (nx,) m, the grid's nodes along x.
        y: (ny,) m, along y.
        force: (ny, nx, 3) N on each node.
        wrench: (6,) net force, N, and torque about the origin of S, N m.
        wrench_cov: (6, 6) its covariance.
        gauge_pressure: Pa in the chamber, as estimated.
        method: Name of the estimator.
        status: "ok", or why it is not to be trusted.
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
    """What touches: all of it, or one patch.

    Attributes:
        touching: Whether anything does. If not, `area` is 0 and `centroid` NaN.
        area: m^2 of the membrane that is in contact.
        centroid: (2,) m in S, the middle of the contact.
        depth: m of the deepest indentation against the rest shape.
        mask: (ny, nx) the traction grid's nodes in contact.
        status: "ok", or why it is not to be trusted.
        force: (3,) N on a single patch, S.
        outline: (P, 2) m, a single patch's border as a closed polygon.
        semi_axes: (2,) m, of the ellipse of the same second moments, the larger first.
        angle: rad of the larger one from x.
        area_source: What `area` and `outline` are of: the "nodal" estimate of pressures, or the
            family of the body that was found (`Touch.shape`).
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

    def __post_init__(self) -> None:
        freeze(self, "centroid", self.centroid, (2,))
        freeze(self, "mask", self.mask, (None, None), np.bool_)
        freeze(self, "force", self.force, (3,))
        freeze(self, "outline", self.outline, (None, 2))
        freeze(self, "semi_axes", self.semi_axes, (2,))
        keep_status(self)


SlipState = Literal["none", "sticking", "incipient", "slipping", "unknown"]
SLIP_STATES: tuple[str, ...] = get_args(SlipState)


@dataclass(frozen=True, eq=False)
class Slip:
    """Whether the object slips on the membrane.

    Attributes:
        state: One of SLIP_STATES. "none": nothing touches; "slipping": all of the contact slides,
            as seen, whatever the friction; "incipient": most of the friction is used up, as far as
            it is known.
        velocity: (2,) m/s of the object over the membrane, S; noise while it sticks. By the
            body's own place where its shape is read, else by the centre of what presses.
        distance: m slipped since the touch began.
        stick_ratio: Share of the contact whose shear is below what friction can hold there.
        status: "ok", or why nothing is known.
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
    """What one sensor feels, from one image.

    Attributes:
        time: Of the image's capture, s.
        age: s from then until now.
        force_normal: N, positive for a press; NaN when `status` is not "ok": unknown is not zero.
        force_normal_sd: Its standard deviation, N.
        touching: Whether anything touches.
        contact: All that touches, taken together.
        traction: Forces over the membrane, and the net wrench.
        surface: The membrane's shape.
        markers: The markers that were seen.
        status: "ok", or why the force is unknown.
        patches: Each place of contact, the strongest first.
        slip: Whether the object slips.
        shape: What body touches; None where nobody asked (`StatefulPipeline(shapes=True)`).
        camera: How the camera has changed, by the fiducials; None: there are none, or too few seen.
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
    """In place of an image: the `touch` that would be found in it. It has no pixels."""

    touch: Touch | None = None

    @classmethod
    def of(cls, touch: Touch) -> SyntheticTouch:
        """Hand over a touch where an image would be.

        Args:
            touch: What is felt.

        Returns:
            The touch in place of an image of its time.
        """
        return cls(NO_PIXELS, touch.time, touch)
