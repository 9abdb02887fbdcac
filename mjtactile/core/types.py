"""Frozen, validated values that the stages pass to each other; arrays in them are read-only.

SI units throughout, except where a name ends in `_px`. Frames (monogram notation,
docs/conventions.md): S sensor (origin at the middle of the frame, in the flat membrane's plane, z
outward, away from the camera), C camera (x right, y down, z forward), M marker. `p_SM` is the
position of marker M expressed in S.

This, and `mjtactile.hold`, is all of the project that a controller may import.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from numbers import Real
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjtactile.core.errors import InputError
from mjtactile.core.status import OK, Status

Array = NDArray[Any]  # of float64; numpy's stubs cannot follow dtypes through arithmetic
FINGERS = ("left", "right")
"""What the fingers of a pair are called, in this order."""


def _keep_status(owner: Any) -> None:
    """Give the frozen dataclass `owner` a status with a code, whatever text it was made with."""
    object.__setattr__(owner, "status", Status.of(owner.status))


def _freeze(
    owner: object, name: str, value: ArrayLike, shape: tuple[int | None, ...], dtype: Any = float
) -> NDArray:
    """Store `value` on the frozen dataclass `owner` as a read-only array of the given shape (None:
    any length)."""
    array = np.asarray(value, dtype=dtype)
    if array.shape != shape and (
        array.ndim != len(shape)
        or any(want not in (None, got) for want, got in zip(shape, array.shape, strict=True))
    ):
        raise InputError(
            f"shape {array.shape} does not match {shape}", source=type(owner).__name__, field=name
        )
    if array.flags.writeable:
        array = array.copy()
        array.setflags(write=False)
    object.__setattr__(owner, name, array)
    return array


@dataclass(frozen=True, eq=False)
class Image:
    """An image of one camera.

    Attributes:
        pixels: (H, W) uint8 grey levels, indexed [v, u]; pixel (0, 0) is the centre of the top-left
            pixel.
        time: Of capture, s.
    """

    pixels: NDArray[np.uint8]
    time: float = 0.0

    def __post_init__(self) -> None:
        _freeze(self, "pixels", self.pixels, (None, None), np.uint8)


@dataclass(frozen=True, eq=False)
class Ellipses:
    """N ellipses in distorted pixel coordinates: centre (N, 2), semi-axes a >= b (N, 2), angle of a
    (N,) rad.

    `cov` (N, 5, 5) is the covariance of (u, v, a, b, angle); `status` (N,) strings; `darkness` (N,)
    the logarithm of the level inside over that `outside` (N,), and `blur_px` (N,) the edge's sd
    (None: unknown).
    """

    center_px: Array
    semi_axes_px: Array
    angle: Array
    cov: Array
    status: NDArray[np.str_]
    darkness: Array | None = None
    outside: Array | None = None
    blur_px: Array | None = None

    def __post_init__(self) -> None:
        n = len(np.asarray(self.center_px))
        _freeze(self, "center_px", self.center_px, (n, 2))
        _freeze(self, "semi_axes_px", self.semi_axes_px, (n, 2))
        _freeze(self, "angle", self.angle, (n,))
        _freeze(self, "cov", self.cov, (n, 5, 5))
        _freeze(self, "status", self.status, (n,), np.str_)
        for name in ("darkness", "outside", "blur_px"):
            value = getattr(self, name)
            if value is not None:
                _freeze(self, name, value, (n,))

    def __len__(self) -> int:
        return len(self.angle)


@dataclass(frozen=True, eq=False)
class Sighting(Image):
    """In place of an image: the `ellipses` that would be found in it. It has no pixels."""

    ellipses: Ellipses | None = None

    @classmethod
    def of(cls, ellipses: Ellipses, time: float) -> Sighting:
        return cls(np.zeros((0, 0), np.uint8), time, ellipses)


@dataclass(frozen=True, eq=False)
class CirclePoses:
    """N circles in the camera frame: centre `p_CM` (N, 3) m, the two candidate unit normals `n_C`,
    `n_C_alt` (N, 3).

    Normals point towards the camera. `p_CM_alt` is the centre that goes with `n_C_alt`. `uv_px` (N,
    2) is the projected *centre* (not the ellipse's) in distorted pixels; `cov_p` (N, 3, 3) m^2;
    `status` (N,) strings.
    """

    uv_px: Array
    p_CM: Array
    n_C: Array
    p_CM_alt: Array
    n_C_alt: Array
    cov_p: Array
    status: NDArray[np.str_]

    def __post_init__(self) -> None:
        n = len(np.asarray(self.uv_px))
        _freeze(self, "uv_px", self.uv_px, (n, 2))
        for name in ("p_CM", "n_C", "p_CM_alt", "n_C_alt"):
            _freeze(self, name, getattr(self, name), (n, 3))
        _freeze(self, "cov_p", self.cov_p, (n, 3, 3))
        _freeze(self, "status", self.status, (n,), np.str_)

    def __len__(self) -> int:
        return len(self.uv_px)


@dataclass(frozen=True, eq=False)
class FiducialsSeen:
    """What an image shows of the circles that do not move.

    Attributes:
        ids: (n,) Of the sensor file's list, in order.
        center_px: (n, 2) In distorted pixels.
        radius_px: (n,) Root of the product of the semi-axes.
        cov: (n, 3, 3) Covariance of (u, v, radius), px^2.
        inside: (n,) Grey levels of the circles; NaN: unknown.
        outside: (n,) Of the ground around them.
        blur_px: (n,) Their edges' sd.
    """

    ids: NDArray[np.int64]
    center_px: Array
    radius_px: Array
    cov: Array
    inside: Array
    outside: Array
    blur_px: Array

    def __post_init__(self) -> None:
        n = len(np.asarray(self.ids))
        _freeze(self, "ids", self.ids, (n,), np.int64)
        _freeze(self, "center_px", self.center_px, (n, 2))
        _freeze(self, "cov", self.cov, (n, 3, 3))
        for name in ("radius_px", "inside", "outside", "blur_px"):
            _freeze(self, name, getattr(self, name), (n,))

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def has_levels(self) -> bool:
        """Whether grey levels and blur are known: those of an image are."""
        return bool(np.isfinite(self.inside + self.outside + self.blur_px).all())


@dataclass(frozen=True, eq=False)
class CameraChange:
    """How a camera differs from what it was at the rest reference, by the fiducials of one image.

    What planar circles hardly tell apart (a camera that moved aside or turned; one that came nearer
    or shows all larger) is shared out as likely; all of it together is well known.

    Attributes:
        shift: (2,) px by which the picture's middle has moved.
        turn: About the camera's axis, rad.
        scale: Share by which all is larger.
        grown_px: By how much circles' radii are larger beside that: gamma, clipping.
        light: Level of white over that at the reference.
        gamma: Exponent 1/gamma with which levels go now; NaN: unknown.
        black: Level that no light has now; more than at the reference is fog.
        blur_px: More blur, sd, px; less than 0: sharper.
        seen: Number of fiducials that this is from.
        misfit: Mean square of what they do not agree about, over its variance.
    """

    shift: tuple[float, float]
    turn: float
    scale: float
    grown_px: float
    light: float
    gamma: float
    black: float
    blur_px: float
    seen: int
    misfit: float


@dataclass(frozen=True, eq=False)
class Markers:
    """Identified markers in the sensor frame: `ids` (N,) indices into the design's layout, `p_SM`,
    `n_S` (N, 3); `darkness` (N,) of each as in `Ellipses` (None: unknown); what was seen of the
    `fiducials` with them (None: there are none)."""

    ids: NDArray[np.int64]
    p_SM: Array
    n_S: Array
    cov_p: Array
    darkness: Array | None = None
    fiducials: FiducialsSeen | None = None

    def __post_init__(self) -> None:
        n = len(np.asarray(self.ids))
        _freeze(self, "ids", self.ids, (n,), np.int64)
        _freeze(self, "p_SM", self.p_SM, (n, 3))
        _freeze(self, "n_S", self.n_S, (n, 3))
        _freeze(self, "cov_p", self.cov_p, (n, 3, 3))
        if self.darkness is not None:
            _freeze(self, "darkness", self.darkness, (n,))

    def __len__(self) -> int:
        return len(self.ids)


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
        nx = len(_freeze(self, "x", self.x, (None,)))
        ny = len(_freeze(self, "y", self.y, (None,)))
        _freeze(self, "z", self.z, (ny, nx))
        _keep_status(self)


@dataclass(frozen=True, eq=False)
class Traction:
    """Force that the outside world exerts on the membrane, in S. A press has a negative z.

    Attributes:
        x: (nx,) m, the grid's nodes along x.
        y: (ny,) m, along y.
        force: (ny, nx, 3) N on each node.
        wrench: (6,) net force, N, and torque about the origin of S, N m.
        wrench_cov: (6, 6) its covariance.
        pressure_gauge: Pa in the chamber, as estimated.
        method: Name of the estimator.
        status: "ok", or why it is not to be trusted.
    """

    x: Array
    y: Array
    force: Array
    wrench: Array
    wrench_cov: Array
    pressure_gauge: float
    method: str
    status: Status = OK

    def __post_init__(self) -> None:
        nx = len(_freeze(self, "x", self.x, (None,)))
        ny = len(_freeze(self, "y", self.y, (None,)))
        _freeze(self, "force", self.force, (ny, nx, 3))
        _freeze(self, "wrench", self.wrench, (6,))
        _freeze(self, "wrench_cov", self.wrench_cov, (6, 6))
        _keep_status(self)


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
        area_from: What `area` and `outline` are of: the "nodal" estimate of pressures, or the
            family of the body that was found (`Touch.shape`).
    """

    touching: bool
    area: float
    centroid: Array
    depth: float
    mask: NDArray[np.bool_]
    status: Status = OK
    force: Array = field(default_factory=lambda: np.full(3, np.nan))
    outline: Array = field(default_factory=lambda: np.zeros((0, 2)))
    semi_axes: Array = field(default_factory=lambda: np.full(2, np.nan))
    angle: float = np.nan
    area_from: str = "nodal"

    def __post_init__(self) -> None:
        _freeze(self, "centroid", self.centroid, (2,))
        _freeze(self, "mask", self.mask, (None, None), np.bool_)
        _freeze(self, "force", self.force, (3,))
        _freeze(self, "outline", self.outline, (None, 2))
        _freeze(self, "semi_axes", self.semi_axes, (2,))
        _keep_status(self)


SHAPES: tuple[str, ...] = ("smooth", "face", "edge", "tip", "several")
"""Kinds of bodies by touch: smooth (two curvatures: plane, ball, lying cylinder), a flat face with
a rim (round, or straight sides), an edge and a tip (sharper than 4 mm of radius, along a line or
at a point); several bodies at once (`FeltShape.parts`)."""


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """How a body moves against the rubber that it touches, over the last images; frame S. What is
    not known, or has no meaning for the body, is NaN.

    Attributes:
        velocity: (2,) m/s of the body's place over the rubber's material: it rolls or slides.
        velocity_cov: (2, 2).
        rolling: (2,) rad/s about x and y: of a flat face as its tilt tells; of a round body what
            `velocity` comes to where it does not slip.
        rolling_cov: (2, 2).
        sliding: (2,) m/s, what of `velocity` is no rolling.
        spinning: rad/s about z over the rubber; NaN for what looks the same all around.
        spinning_sd: rad/s.
    """

    velocity: Array
    velocity_cov: Array
    rolling: Array
    rolling_cov: Array
    sliding: Array
    spinning: float
    spinning_sd: float

    def __post_init__(self) -> None:
        for name in ("velocity", "rolling", "sliding"):
            _freeze(self, name, getattr(self, name), (2,))
        for name in ("velocity_cov", "rolling_cov"):
            _freeze(self, name, getattr(self, name), (2, 2))


@dataclass(frozen=True, eq=False)
class FeltShape:
    """What body touches, as the membrane's shape tells. What is not known, or has no meaning for
    the kind, is NaN; frame S.

    Attributes:
        kind: One of SHAPES, or "unknown", and then `status` says why.
        probabilities: Of each of SHAPES.
        curvatures: (2,) 1/m of a smooth body where it touches, the larger first.
        curvatures_sd: (2,) 1/m.
        direction: rad from x of an edge, or of a smooth body's smaller curvature.
        direction_sd: rad.
        radius: m of a ball, of a lying cylinder, of a disc's rim.
        radius_sd: m.
        area: m^2 of the sheet that lies on it.
        area_interval: m^2, 68 %, over the kinds that may be.
        p_SO: (3,) m, its point that is nearest the sensor; of an edge, one on it.
        R_SO: (3, 3) its axes; x along an edge or the smaller curvature, z away from the sensor.
        pose_cov: (6, 6) of p_SO, m, and of small turns about the axes of S, rad.
        outline: (P, 2) m, border of the contact.
        force_normal: N that the body takes to be so deep in the sheet.
        family: The narrower kind: "ball" and "cylinder" are "smooth", "disc" and "block" a "face";
            of several bodies the families, with "+" between.
        misfit: Mean square of the markers' heights over their sd: near 1.
        status: "ok", or why it is unknown.
        parts: Where several bodies touch, each of them, the strongest first; pose and outline are
            then the first one's, area and force of all.
        motion: Against the rubber; None: too few images of it were felt one after the other.
    """

    kind: str
    probabilities: Mapping[str, float]
    curvatures: Array = field(default_factory=lambda: np.full(2, np.nan))
    curvatures_sd: Array = field(default_factory=lambda: np.full(2, np.nan))
    direction: float = np.nan
    direction_sd: float = np.nan
    radius: float = np.nan
    radius_sd: float = np.nan
    area: float = np.nan
    area_interval: tuple[float, float] = (np.nan, np.nan)
    p_SO: Array = field(default_factory=lambda: np.full(3, np.nan))
    R_SO: Array = field(default_factory=lambda: np.full((3, 3), np.nan))
    pose_cov: Array = field(default_factory=lambda: np.full((6, 6), np.nan))
    outline: Array = field(default_factory=lambda: np.zeros((0, 2)))
    force_normal: float = np.nan
    family: str = "unknown"
    misfit: float = np.nan
    status: Status = OK
    parts: tuple[FeltShape, ...] = ()
    motion: BodyMotion | None = None

    def __post_init__(self) -> None:
        if self.kind not in (*SHAPES, "unknown"):
            raise InputError(
                f"{self.kind!r} is not a shape",
                source="FeltShape",
                field="kind",
                choices=(*SHAPES, "unknown"),
            )
        object.__setattr__(self, "probabilities", MappingProxyType(dict(self.probabilities)))
        for name, shape in (
            ("curvatures", (2,)),
            ("curvatures_sd", (2,)),
            ("p_SO", (3,)),
            ("R_SO", (3, 3)),
            ("pose_cov", (6, 6)),
            ("outline", (None, 2)),
        ):
            _freeze(self, name, getattr(self, name), shape)
        _keep_status(self)

    def __reduce__(self):  # a mappingproxy does not pickle
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return (_felt_shape, (values | {"probabilities": dict(self.probabilities)},))


def _felt_shape(values: dict[str, Any]) -> FeltShape:
    return FeltShape(**values)


SlipState = Literal["none", "sticking", "incipient", "slipping", "unknown"]
SLIP_STATES: tuple[str, ...] = get_args(SlipState)


@dataclass(frozen=True, eq=False)
class Slip:
    """Whether the object slips on the membrane.

    Attributes:
        state: One of SLIP_STATES. "none": nothing touches; "slipping": all of the contact slides,
            as seen, whatever the friction; "incipient": most of the friction is used up, as far as
            it is known.
        velocity: (2,) m/s of the object over the membrane, S; noise while it sticks.
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
        _freeze(self, "velocity", self.velocity, (2,))
        _keep_status(self)


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
        shape: What body touches; None where nobody asked (`Perception(shapes=True)`).
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
    shape: FeltShape | None = None
    camera: CameraChange | None = None

    def __post_init__(self) -> None:
        _keep_status(self)


MATERIALS: tuple[str, ...] = ("solid", "soft", "amorphous")


@dataclass(frozen=True, eq=False)
class Material:
    """What a probe says an object is made of. What is not known is NaN, an open end of an interval
    is inf.

    `kind` is one of MATERIALS or "unknown", `probability` has one entry a class. `stiffness` N/m of
    the whole object, the force over the deformation that it can recover from; `modulus` Pa, the
    same as stress over strain between flat faces; each with a 68 % interval. `relaxation_time` s
    (0: none was seen), `deformation` m under `force` N, of which `permanent_set` m stayed, `speed`
    m/s at which it went on deforming when the fingers had stopped.
    """

    kind: str
    probability: Mapping[str, float]
    force: float = float("nan")
    deformation: float = float("nan")
    stiffness: float = float("nan")
    stiffness_interval: tuple[float, float] = (float("nan"), float("nan"))
    modulus: float = float("nan")
    modulus_interval: tuple[float, float] = (float("nan"), float("nan"))
    relaxation_time: float = float("nan")
    permanent_set: float = float("nan")
    permanent_set_sd: float = float("nan")
    speed: float = float("nan")
    status: Status = OK

    def __post_init__(self) -> None:
        if self.kind not in (*MATERIALS, "unknown"):
            raise InputError(
                f"{self.kind!r} is not a material",
                source="Material",
                field="kind",
                choices=(*MATERIALS, "unknown"),
            )
        object.__setattr__(self, "probability", MappingProxyType(dict(self.probability)))
        _keep_status(self)


@dataclass(frozen=True)
class GripperState:
    """What the gripper reports.

    Attributes:
        opening: m between the two sensors' frames.
        speed: m/s of the opening.
        effort: N at the jaw, as the servo believes it.
        lift_height: m of the hand above where it started.
        time: s on the rig's clock at which it was so (NaN: not known).
        age: s from then until it was handed over (NaN: not known).
    """

    opening: float
    speed: float
    effort: float
    lift_height: float
    time: float = float("nan")
    age: float = float("nan")


@dataclass(frozen=True)
class ValveState:
    """What the valve of one chamber reports.

    Attributes:
        is_open: Whether the chamber is connected to its supply.
        pressure_gauge: Pa in the chamber above ambient; None where the rig has no pressure sensor.
        time: s on the rig's clock at which it was measured (NaN: not known).
        age: s from then until it was handed over (NaN: not known).
    """

    is_open: bool
    pressure_gauge: float | None = None
    time: float = float("nan")
    age: float = float("nan")


@dataclass(frozen=True)
class PressureReading:
    """What the pressure gauge of a chamber showed at `time` s on the images' clock: Pa above the
    air's, its zero taken off, with its `sd`; and whether the valve was open then."""

    pressure_gauge: float
    sd: float
    time: float
    is_open: bool = False


Phase = Literal[
    "approach", "close", "regulate", "lift", "hold", "lower", "release", "done", "abort"
]
PHASES: tuple[str, ...] = get_args(Phase)


def _finite(value: Any, field: str) -> float:
    """A number of a Command. Raises InputError."""
    with contextlib.suppress(ArithmeticError, TypeError, ValueError):
        if isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    raise InputError(f"{value!r} is not a finite number", source="Command", field=field)


@dataclass(frozen=True)
class Command:
    """What a controller asks for. The rig limits it and returns what was really sent.

    Attributes:
        opening: m, the gripper's goal.
        force_limit: N, the most that the servo may push.
        lift_height: m, the hand's goal.
        phase: One of PHASES; "done" and "abort" end the run.
        memory: The controller's own notebook: the loop hands it back in the next
            `Observation.command`, so that `step` can be a pure function.
        reason: Why the controller gives up, or sets down early; for the result and the log.
        pressure_gauge: Pa above ambient in each finger's chamber, in their order, which the valves
            then keep. None: leave the air alone, sealed in.
    """

    opening: float
    force_limit: float
    lift_height: float = 0.0
    phase: str = "approach"
    memory: Mapping[str, float] = field(default_factory=dict)
    reason: str = ""
    pressure_gauge: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        for name in ("opening", "force_limit", "lift_height"):
            object.__setattr__(self, name, _finite(getattr(self, name), name))
        if not isinstance(self.phase, str) or self.phase not in PHASES:
            raise InputError(
                f"{self.phase!r} is not a phase", source="Command", field="phase", choices=PHASES
            )
        if not isinstance(self.reason, str):
            raise InputError(f"{self.reason!r} is no text", source="Command", field="reason")
        if self.pressure_gauge is not None:
            pressures = tuple(_finite(one, "pressure_gauge") for one in self.pressure_gauge)
            object.__setattr__(self, "pressure_gauge", pressures)
        object.__setattr__(self, "memory", MappingProxyType(dict(self.memory)))

    def checked(self) -> Command:
        """Check every value again, also of a subclass, or what was changed past the checks.

        Returns:
            A plain Command of the same values.

        Raises:
            InputError: A value is not what it must be.
        """
        return Command(**{one.name: getattr(self, one.name) for one in fields(Command)})

    def __reduce__(self):  # a mappingproxy does not pickle
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        return Command, tuple((values | {"memory": dict(self.memory)}).values())


@dataclass(frozen=True)
class Told:
    """What a task asks of the robot.

    Attributes:
        lift_height: m, how high it shall lift.
        hold_time: s, how long it shall hold there.
        place_height: m of the hand over where it gripped, where the thing shall be set down; the
            place may be higher or lower than that.
        hand_over: Whether somebody will take the thing out of the hand.
        push: N, as hard as somebody may push it, from any side.
    """

    lift_height: float = 0.040
    hold_time: float = 2.0
    place_height: float = 0.0
    hand_over: bool = False
    push: float = 0.0


TOLD = Told()


@dataclass(frozen=True, eq=False)
class Observation:
    """What a controller sees once a control cycle: only what the sensors say.

    Attributes:
        time: s on the rig's clock.
        period: s from one cycle to the next.
        touch: One value a finger, in the order of the rig (left, right).
        gripper: The gripper's newest state.
        valves: The valves' states, in the order of the fingers that have one.
        command: The last command really sent, with the `phase` and `memory` that the controller put
            into it.
        told: What the task asks for.
    """

    time: float
    period: float
    touch: tuple[Touch, ...]
    gripper: GripperState
    valves: tuple[ValveState, ...]
    command: Command
    told: Told = TOLD
