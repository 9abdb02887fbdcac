"""Conversion of one contact of one sensor to a patch of the object's surface."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array, ContactShape, Surface, Touch
from mjtactile.explore.surface_patch import Patch

# sample radii, as fractions of the distance from a patch's center to its border
_RINGS = (0.45, 0.85)
_SPOKES = 8
_LINE = 7  # points along an edge
_SHRINK = 0.9  # used fraction of a bounded face: the membrane leaves the face at its border
_CLEAR = 2e-3  # minimum distance of free membrane from a patch, m
_FREE_STEP = 4  # step along the surface's grid, nodes
_STAGE = 2e-5  # positioning error (sd) of stage or jaws, m
_FACE_SD = 4e-5  # height noise (sd) of the membrane on the object from image to image, m
_AGREES = 1e-4  # tolerance between the estimated shape and the membrane on it, m
_MIN_AGREEING = 0.6  # minimum fraction of a patch's points
_HARD = 0.25  # minimum force of an edge node, as a fraction of the strongest node's
_MEMBRANE_SPREAD = (5e-5, 0.01, 15.0, 6e-5)
_SIGNIFICANT = 3.0  # threshold of a compliance, in sd


@dataclass(frozen=True, eq=False)
class Pressed:
    """One contact of one sensor.

    Attributes:
        touches: Touches of the contact, oldest first.
        R_SH: (3, 3) Rotation from the holder's axes to the sensor's.
        p_SH: (n, 3) Holder's origin in S at each image, m.
        shape: Contact shape estimated for the newest image.
        group: Group of contacts with a common displacement of the object, as in `Patch`.
        loose: Standard deviation of that displacement, m.
    """

    touches: tuple[Touch, ...]
    R_SH: Array
    p_SH: Array
    shape: ContactShape
    group: int = 0
    loose: float = 0.0


def patch_from_press(pressed: Pressed, design: SensorDesign) -> Patch | None:
    """Compute the surface patch of one contact; None without contact."""
    touch = pressed.touches[-1]
    if touch.surface is None or touch.contact is None or not touch.touching:
        return None
    shape = pressed.shape
    face = _face_of_shape(shape, touch, design) if len(shape.outline) >= 3 else None
    points_S, normal_S, spread = face or _face_of_membrane(touch, design)
    compliance, compliance_sd = estimate_compliance(pressed)
    free_S = _free(touch, points_S, design)
    force = float(touch.force_normal)
    if compliance > _SIGNIFICANT * compliance_sd:  # surface position before the object yielded
        points_S = points_S + compliance * force * normal_S
    R_HS = pressed.R_SH.T
    origin = pressed.p_SH[-1]
    return Patch(
        (points_S - origin) @ R_HS.T,
        (free_S - origin) @ R_HS.T,
        R_HS @ normal_S,
        shape.kind,
        force,
        compliance,
        compliance_sd,
        spread,
        pressed.group,
        pressed.loose,
    )


def estimate_compliance(pressed: Pressed) -> tuple[float, float]:
    """Estimate the compliance of the object and its sd, m/N: the motion of the holder minus that of
    the membrane at the first contact point, over the force. NaN with fewer than three images."""
    first = pressed.touches[0].traction
    if first is None or len(pressed.touches) < 3:
        return math.nan, math.nan
    row, column = np.unravel_index(int(first.force[:, :, 2].argmin()), first.force.shape[:2])
    at = np.array([[first.x[column], first.y[row]]])
    rows = [
        (touch.force_normal, origin[2] - float(_membrane_height(touch.surface, at)[0]))
        for touch, origin in zip(pressed.touches, pressed.p_SH, strict=True)
        if touch.surface is not None and math.isfinite(touch.force_normal)
    ]
    force, motion = np.array(rows).T
    spread = force - force.mean()
    weight = float(spread @ spread)
    if len(rows) < 3 or weight < 1e-3:
        return math.nan, math.nan
    # the holder goes down as the force grows
    return float(-(spread @ motion) / weight), _FACE_SD / math.sqrt(weight)


def _membrane_height(surface: Surface, xy: Array) -> Array:
    """Return the heights (N,) m of the membrane at positions (N, 2) m."""
    grid = RegularGridInterpolator((surface.y, surface.x), surface.z)
    low, high = (surface.x[0], surface.y[0]), (surface.x[-1], surface.y[-1])
    return grid(np.clip(xy, low, high)[:, ::-1])


_Face = tuple[Array, Array, tuple[float, float, float, float]]
"""Points (N, 3) m in S, the outward normal, and spreads as `Patch` has them."""


def _face_of_shape(shape: ContactShape, touch: Touch, design: SensorDesign) -> _Face | None:
    """Return points of the estimated shape inside its outline; None if the membrane does not lie on
    it."""
    center = shape.outline.mean(axis=0)
    if shape.kind == "edge":
        xy = _along(shape, center)
    else:
        xy = _inside(shape.outline, center, _SHRINK if shape.kind == "flat" else 1.0)
    x, y = (xy - shape.p_SO[:2]).T
    z, slope = _heights(shape, x, y)
    points = np.column_stack([xy, shape.p_SO[2] + z])
    assert touch.surface is not None
    gap = points[:, 2] - _membrane_height(touch.surface, xy) - design.membrane.thickness / 2
    on = np.abs(gap) < _AGREES
    if on.sum() < max(_MIN_AGREEING * len(gap), 3):
        return None
    normal = np.array([slope[0], slope[1], -1.0])
    return points[on], normal / np.linalg.norm(normal), _spread(shape)


def _heights(shape: ContactShape, x: Array, y: Array) -> tuple[Array, Array]:
    """Return heights of a shape over its point nearest the sensor, and its mean slope (2,)."""
    plane = np.zeros(2)
    if shape.kind == "flat" or shape.family == "cylinder":
        z_axis = shape.R_SO[:, 2]
        plane = -z_axis[:2] / z_axis[2]
    maximum, minimum = np.nan_to_num(shape.curvatures)
    angle = shape.direction if math.isfinite(shape.direction) else 0.0
    c, s = math.cos(angle), math.sin(angle)
    along, across = c * x + s * y, c * y - s * x
    z = (
        plane[0] * x
        + plane[1] * y
        + _circle_height(minimum, along)
        + _circle_height(maximum, across)
    )
    center_along, center_across = along.mean(), across.mean()
    slope_x = minimum * center_along * c - maximum * center_across * s
    slope_y = minimum * center_along * s + maximum * center_across * c
    return z, plane + np.array([slope_x, slope_y])


def _circle_height(curvature: float, distance: Array) -> Array:
    """Return the height of a circle over its lowest point. The horizontal distance is limited to
    0.8 of the radius, so that the rise stays below half of it."""
    if abs(curvature) < 1e-3:
        return 0.5 * curvature * distance**2
    radius = 1 / curvature
    short = np.minimum(np.abs(distance), 0.8 * abs(radius))
    return radius - math.copysign(1, radius) * np.sqrt(radius**2 - short**2)


def _inside(outline: Array, center: Array, shrink: float) -> Array:
    """Return positions on a patch: its center and rings."""
    offsets = outline - center
    angle = np.arctan2(offsets[:, 1], offsets[:, 0])
    far = np.hypot(offsets[:, 0], offsets[:, 1])
    spokes = np.arange(_SPOKES) * (2 * math.pi / _SPOKES)
    order = np.argsort(angle)
    extent = shrink * np.interp(spokes, angle[order], far[order], period=2 * math.pi)
    rays = np.column_stack([np.cos(spokes), np.sin(spokes)])
    rings = [center + fraction * extent[:, None] * rays for fraction in _RINGS]
    return np.concatenate([[center], *rings])


def _along(shape: ContactShape, center: Array) -> Array:
    """Return points along the contacting part of an edge."""
    ray = np.array([math.cos(shape.direction), math.sin(shape.direction)])
    across = np.array([-ray[1], ray[0]])
    on = center + across * (across @ (shape.p_SO[:2] - center))
    extent = (shape.outline - on) @ ray
    return on + np.linspace(0.8 * extent.min(), 0.8 * extent.max(), _LINE)[:, None] * ray


def _spread(shape: ContactShape) -> tuple[float, float, float, float]:
    """Return the uncertainty of the shape's position, tilt and curvatures."""
    variance = np.nan_to_num(np.diag(shape.pose_cov))
    height = math.hypot(math.sqrt(max(variance[2], 0.0)), _STAGE)
    bent = float(np.nanmax(np.abs(np.nan_to_num(shape.curvatures))))
    lateral = math.sqrt(max(variance[0], variance[1], 0.0))
    tilt = math.sqrt(max(variance[3], variance[4], 0.0) + (bent * lateral) ** 2)
    curvature = float(np.nanmax(np.nan_to_num(shape.curvatures_sd)))
    if shape.kind in ("edge", "point"):  # the contact does not show how far the faces are tilted
        return height + 5e-5, 0.1, curvature, 5e-5
    return height, max(tilt, 3e-3), max(curvature, 1.0), 2e-5


def _face_of_membrane(touch: Touch, design: SensorDesign) -> _Face:
    """Return the membrane's outer face at the largest pressure, with a larger uncertainty."""
    assert touch.surface is not None and touch.contact is not None and touch.traction is not None
    traction = touch.traction
    pressing = -traction.force[:, :, 2] * touch.contact.mask
    rows, columns = np.nonzero(pressing > _HARD * pressing.max())
    xy = np.column_stack([traction.x[columns], traction.y[rows]])
    z = _membrane_height(touch.surface, xy)
    points = np.column_stack([xy, z + design.membrane.thickness / 2])
    centered = points - points.mean(axis=0)
    normal = np.array([0.0, 0.0, -1.0])
    if len(points) >= 4:
        slope = np.linalg.lstsq(centered[:, :2], centered[:, 2], rcond=1e-2)[0]
        normal = np.array([*slope, -1.0]) / math.hypot(*slope, 1.0)
    return points, normal, _MEMBRANE_SPREAD


def _free(touch: Touch, points_S: Array, design: SensorDesign) -> Array:
    """Return positions on the membrane's outer face that are clear of the patch."""
    assert touch.surface is not None
    s = touch.surface
    x, y = np.meshgrid(s.x[::_FREE_STEP], s.y[::_FREE_STEP])
    z = s.z[::_FREE_STEP, ::_FREE_STEP]
    face = np.column_stack([x.ravel(), y.ravel(), z.ravel() + design.membrane.thickness / 2])
    distance = np.linalg.norm(face[:, None, :2] - points_S[None, :, :2], axis=2).min(axis=1)
    return face[distance > _CLEAR]
