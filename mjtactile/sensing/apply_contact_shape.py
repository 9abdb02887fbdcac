"""What a touch becomes where it is known what body touches: area and force are the body's."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mjtactile.core.types import Array, Contact, ContactShape, Touch
from mjtactile.sensing.contact_shape.estimator import Found
from mjtactile.sensing.contact_shape.force_fusion import ContactLoad, with_load
from mjtactile.sensing.contact_shape.relative_motion import MembraneMotion, rubber_step
from mjtactile.sensing.pipeline_state import PipelineState, Reference
from mjtactile.sensing.settings import SlipSettings
from mjtactile.sensing.touch.slip_from_motion import with_motion

_GAUGE_STEP = 1.02  # of the gas at rest, after which shapes want another film


def finder_gauge(reference: Reference) -> float:
    """Pa of the gas at rest that a finder is made for.

    What a touch squeezes sealed gas to is no part of it: that is in the film.

    Args:
        reference: The rest.

    Returns:
        As first measured; in steps of 2 % of it where gas was let in or out, lost or grew warm.
    """
    first = reference.first.gas.gauge
    rest = reference.rest
    now = rest.gauge_pressure if math.isfinite(rest.gauge_pressure) else rest.gas.gauge
    return first * _GAUGE_STEP ** round(math.log(max(now, 1.0) / first) / math.log(_GAUGE_STEP))


def attach_shape(
    touch: Touch,
    shape: ContactShape,
    load: ContactLoad | None = None,
    sharpness: Array | None = None,
) -> Touch:
    """A touch that knows what body it is of.

    Args:
        touch: As the nodal estimate has it.
        shape: What was found of it.
        load: What that body bears; None: the force stays the nodal estimate's.
        sharpness: (6,) As `with_load` has it; None: nothing.

    Returns:
        The touch with `shape`; where one is known, area and outline are the body's and
        `contact.area_source` says so, and the wrench takes up what the body bears.
    """
    contact = touch.contact
    if contact is None or shape.kind == "unknown":
        return replace(touch, shape=shape)
    sharp = np.zeros(6) if sharpness is None else sharpness
    felt = touch if load is None else with_load(touch, load, sharp)
    by_body = replace(contact, area=shape.area, outline=shape.outline, area_source=shape.family)
    patches = (by_body,) if len(touch.patches) == 1 else _patches_of(touch.patches, shape.parts)
    return replace(felt, shape=shape, contact=by_body, patches=patches)


def apply_shape_and_motion(
    touch: Touch, found: Found, after: PipelineState, sharpness: Array, settings: SlipSettings
) -> tuple[Touch, PipelineState]:
    """A touch with the body that was `found`, by whose motion its slip is judged.

    Args:
        touch: As the nodal estimate has it.
        found: The body, and what the press has told of it so far.
        after: The state after the image.
        sharpness: (6,) As `with_load` has it.
        settings: Of slip.

    Returns:
        The touch, and the state that remembers the press.
    """
    felt = attach_shape(touch, found.shape, found.load, sharpness)
    after = replace(after, press=found.press)
    if felt.slip is None:
        return felt, after
    judged, history = with_motion(felt.slip, after.slip, found.shape.motion, settings)
    return replace(felt, slip=judged), replace(after, slip=history)


def membrane_displacement(before: PipelineState, after: PipelineState) -> MembraneMotion | None:
    """How the rubber that touches has moved from one image to the next; None: unknown."""
    if before.slip is None or after.slip is None:
        return None
    return rubber_step(
        (before.slip.weight, after.slip.weight), (before.slip.position, after.slip.position)
    )


def _patches_of(
    patches: tuple[Contact, ...], bodies: tuple[ContactShape, ...]
) -> tuple[Contact, ...]:
    """Each with the area of the body that is nearest, if there are as many."""
    if len(bodies) != len(patches):
        return patches
    left = list(bodies)
    found = []
    for patch in patches:
        nearest = min(left, key=lambda body: math.dist(body.p_SO[:2], patch.centroid))
        left.remove(nearest)
        found.append(
            replace(patch, area=nearest.area, outline=nearest.outline, area_source=nearest.family)
        )
    return tuple(found)
