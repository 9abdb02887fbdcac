"""What body touches, how it moves, and what it is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.status import OK, Status
from mjtactile.core.types.arrays import Array, freeze, keep_status

SHAPES: tuple[str, ...] = ("smooth", "face", "edge", "tip", "several")
"""Kinds of bodies by touch: smooth (two curvatures: plane, ball, lying cylinder), a flat face with
a rim (round, or straight sides), an edge and a tip (sharper than 4 mm of radius, along a line or
at a point); several bodies at once (`ContactShape.parts`)."""


@dataclass(frozen=True, eq=False)
class RelativeMotion:
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
            freeze(self, name, getattr(self, name), (2,))
        for name in ("velocity_cov", "rolling_cov"):
            freeze(self, name, getattr(self, name), (2, 2))


@dataclass(frozen=True, eq=False)
class ContactShape:
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
    parts: tuple[ContactShape, ...] = ()
    motion: RelativeMotion | None = None

    def __post_init__(self) -> None:
        if self.kind not in (*SHAPES, "unknown"):
            raise InputError(
                f"{self.kind!r} is not a shape",
                source="ContactShape",
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
        keep_status(self)
