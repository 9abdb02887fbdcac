"""Contact shape, motion and material of a touched object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.status import OK, Status
from mjtactile.core.types.arrays import Array, freeze, keep_status

SHAPES: tuple[str, ...] = ("smooth", "flat", "edge", "point", "multiple")
"""Kinds of contact shapes.

"smooth" has two curvatures: plane, ball, lying cylinder. "flat" is a face with an edge all around,
round or with straight sides. "edge" and "point" have a radius below 4 mm, along a line or at a
point. "multiple" is several contacts together (`ContactShape.parts`).
"""


@dataclass(frozen=True, eq=False)
class RelativeMotion:
    """Motion of an object relative to the rubber that it touches, over the last images; frame S.

    Values that are unknown, or have no meaning for the shape, are NaN.

    Attributes:
        velocity: Velocity (2,) m/s of the shape's position relative to the rubber: it rolls or
            slides.
        velocity_cov: Covariance (2, 2) of the velocity.
        rolling: Rolling rate (2,) rad/s about x and y. For a flat face it is measured by its tilt;
            for a round shape it equals `velocity` over the radius while it does not slip.
        rolling_cov: Covariance (2, 2) of the rolling rate.
        sliding: Sliding velocity (2,) m/s, the part of `velocity` without rolling.
        spinning: Rotation rate about z relative to the rubber, rad/s; NaN for rotationally
            symmetric shapes.
        spinning_sd: Standard deviation of the rotation rate, rad/s.
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
            freeze(self, name, getattr(self, name), (2,))
        for name in ("velocity_cov", "rolling_cov"):
            freeze(self, name, getattr(self, name), (2, 2))


@dataclass(frozen=True, eq=False)
class ContactShape:
    """Contact shape estimated from the membrane's shape; frame S.

    Values that are unknown, or have no meaning for the kind, are NaN.

    Attributes:
        kind: One of SHAPES, or "unknown"; then `status` gives the reason.
        probabilities: Probability of each of SHAPES.
        curvatures: Curvatures (2,) 1/m of a smooth shape at the contact, the larger first.
        curvatures_sd: Standard deviations (2,) 1/m.
        direction: Direction of an edge, or of a smooth shape's smaller curvature, rad from x.
        direction_sd: Standard deviation of the direction, rad.
        radius: Radius of a ball, of a lying cylinder, or of a disc's edge, m.
        radius_sd: Standard deviation of the radius, m.
        area: Contact area of the membrane, m^2.
        area_interval: Interval (68 %) of the area over the plausible kinds, m^2.
        p_SO: Point of the object (3,) m that is nearest to the sensor; for an edge, a point on it.
        R_SO: Axes of the object (3, 3); x along an edge or the smaller curvature, z away from the
            sensor.
        pose_cov: Covariance (6, 6) of p_SO, m, and of small rotations about the axes of S, rad.
        outline: Border (P, 2) of the contact, m.
        force_normal: Normal force predicted for the shape's indentation, N.
        family: Specific shape: "ball" and "cylinder" are "smooth", "disc" and "block" are "flat";
            for several contacts the families, joined by "+".
        misfit: Mean square of the markers' height residuals over their variance: near 1.
        status: "ok", or the reason why it is unknown.
        parts: Separate shapes of several contacts, the strongest first. Pose and outline are then
            those of the first. Area and force are those of all.
        motion: Motion relative to the rubber; None: too few consecutive images.
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
    parts: tuple[ContactShape, ...] = ()
    motion: RelativeMotion | None = None

    def __post_init__(self) -> None:
        if self.kind not in (*SHAPES, "unknown"):
            message = f"{self.kind!r} is not a contact shape"
            choices = (*SHAPES, "unknown")
            raise InputError(message, source="ContactShape", field="kind", choices=choices)
        object.__setattr__(self, "probabilities", MappingProxyType(dict(self.probabilities)))
        for name, shape in (
            ("curvatures", (2,)),
            ("curvatures_sd", (2,)),
            ("p_SO", (3,)),
            ("R_SO", (3, 3)),
            ("pose_cov", (6, 6)),
            ("outline", (None, 2)),
        ):
            freeze(self, name, getattr(self, name), shape)
        keep_status(self)

    def __reduce__(self):  # a mappingproxy does not pickle
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return (_contact_shape_at, (values | {"probabilities": dict(self.probabilities)},))


def _contact_shape_at(values: dict[str, Any]) -> ContactShape:
    return ContactShape(**values)


MATERIALS: tuple[str, ...] = ("solid", "soft", "amorphous")


@dataclass(frozen=True, eq=False)
class Material:
    """Material of an object, estimated by probing. Unknown values are NaN; an open end of an
    interval is inf.

    `kind` is one of MATERIALS or "unknown", `probability` has one entry per class. `stiffness` N/m
    is that of the whole object, the force over the recoverable deformation. `modulus` Pa is the
    equivalent stress over strain between flat faces. Each has a 68 % interval. `relaxation_time` s
    is 0 if no relaxation was observed. `deformation` m is under `force` N; `permanent_set` m of it
    remained. `speed` m/s is the speed of the continued deformation after the fingers stopped.
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
            message = f"{self.kind!r} is not a material"
            choices = (*MATERIALS, "unknown")
            raise InputError(message, source="Material", field="kind", choices=choices)
        object.__setattr__(self, "probability", MappingProxyType(dict(self.probability)))
        keep_status(self)
