"""Combination of a touch with its contact shape: area and force then come from the shape."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mjtactile.core.types import Array, Contact, ContactShape, Slip, Touch
from mjtactile.sensing.contact_shape.estimator import Found
from mjtactile.sensing.contact_shape.force_fusion import ContactLoad, with_load
from mjtactile.sensing.contact_shape.relative_motion import MembraneMotion, rubber_step
from mjtactile.sensing.pipeline_state import PipelineState, Reference
from mjtactile.sensing.settings import SlipSettings
from mjtactile.sensing.touch.slip_from_motion import with_motion

_SHARP = 0.05  # area of an edge or tip over its nodal estimate (bench shape, own seeds)
_PLANE = 0.85  # lower end of the interval of a plane's area, over the area
_GAUGE_STEP = 1.02  # ratio of the rest pressure above which the shapes need a new membrane model


def finder_gauge(reference: Reference, current: float | None = None) -> float:
    """Return the gauge pressure at rest for which a shape estimator is made, Pa: the pressure as
    first measured, in steps of 2 % if the valve was open, or the gas leaked or became warmer.
    Compression of sealed gas by a touch is not included, because the membrane model computes it.
    The `current` one stays within a step: pressure noise makes no new estimator."""
    first = reference.first.gas.gauge_pressure
    rest = reference.rest
    now = rest.gauge_pressure if math.isfinite(rest.gauge_pressure) else rest.gas.gauge_pressure
    if current is not None and current / _GAUGE_STEP < now < current * _GAUGE_STEP:
        return current
    return first * _GAUGE_STEP ** round(math.log(max(now, 1.0) / first) / math.log(_GAUGE_STEP))


def attach_shape(
    touch: Touch,
    shape: ContactShape,
    load: ContactLoad | None = None,
    sharpness: Array | None = None,
    slip: Slip | None = None,
) -> Touch:
    """Return the touch with its contact shape. If the shape is known, area and outline come from
    the shape model, `contact.area_source` names it, and the wrench is fused with `load` (None: the
    force of the nodal estimate is kept). For `sharpness` (6,) see `with_load`; None: zero. `slip`
    replaces that of the touch; None: it is kept."""
    contact = touch.contact
    slip = touch.slip if slip is None else slip
    if contact is None or shape.kind == "unknown":
        return replace(touch, shape=shape, slip=slip, contact=_of_unknown_shape(contact))
    sharp = np.zeros(6) if sharpness is None else sharpness
    estimated = {} if load is None else with_load(touch, load, sharp)
    by_body = _with_area(contact, shape)
    patches = (by_body,) if len(touch.patches) == 1 else _patches_of(touch.patches, shape.parts)
    return replace(touch, shape=shape, contact=by_body, patches=patches, slip=slip, **estimated)


def apply_shape_and_motion(
    touch: Touch,
    found: Found,
    after: PipelineState,
    sharpness: Array | None,
    settings: SlipSettings,
) -> tuple[Touch, PipelineState]:
    """Return the touch with the shape `found`, its slip updated by the shape's motion, and the
    state with the history of the contact episode. For `sharpness` (6,) see `with_load`."""
    slip, history = touch.slip, after.slip
    if slip is not None:
        slip, history = with_motion(slip, history, found.shape.motion, settings)
    estimated = attach_shape(touch, found.shape, found.load, sharpness, slip)
    return estimated, replace(after, press=found.press, slip=history)


def membrane_displacement(before: PipelineState, after: PipelineState) -> MembraneMotion | None:
    """Return the motion of the rubber in contact between two images; None: unknown."""
    if before.slip is None or after.slip is None:
        return None
    return rubber_step(
        (before.slip.weight, after.slip.weight), (before.slip.position, after.slip.position)
    )


def _patches_of(
    patches: tuple[Contact, ...], bodies: tuple[ContactShape, ...]
) -> tuple[Contact, ...]:
    """Return each patch with area and outline of its nearest shape, if the counts are equal."""
    if len(bodies) != len(patches):
        return patches
    left = list(bodies)
    found = []
    for patch in patches:
        nearest = min(left, key=lambda body: math.dist(body.p_SO[:2], patch.centroid))
        left.remove(nearest)
        found.append(_with_area(patch, nearest))
    return tuple(found)


def _of_unknown_shape(contact: Contact | None) -> Contact | None:
    """Return the contact with an area interval that includes edges and tips. Under a plane, which
    has a narrow interval, there are none."""
    if contact is None or not contact.touching:
        return contact
    low, high = contact.area_interval
    if low > _PLANE * contact.area:
        return contact
    return replace(contact, area_interval=np.array([_SHARP * contact.area, high]))


def _with_area(contact: Contact, shape: ContactShape) -> Contact:
    """Return the contact with area and outline of a shape."""
    interval = np.array(shape.area_interval)
    return replace(
        contact,
        area=shape.area,
        outline=shape.outline,
        area_source=shape.family,
        area_interval=interval,
    )
