"""By what a sheet that sticks to a body bears more than the film, which slides over it
(docs/theory/contact_shape.md, Eq. F21)."""

from __future__ import annotations

from mjtactile.quasistatic import MembraneSolution
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.settings import ContactShapeSettings


def sticks(forward: ForwardModel, state: MembraneSolution, s: ContactShapeSettings) -> float:
    """Force of a sheet that sticks over that of the film.

    Between a body and the nearer side of the frame the sheet is drawn out more than on the other
    side, and cannot even that out by sliding over the body, as the film does.

    Args:
        forward: The film.
        state: Of it, on the body.
        s: Settings.

    Returns:
        The ratio: `friction` in the middle, more with the square of how far off it presses, in
        halves of the frame.
    """
    force = state.contact_forces
    total = float(force.sum())
    if total <= 0:
        return s.friction
    frame = forward.film.design.frame
    sides = (frame.length, frame.width)
    more = 0.0
    for axis, share in enumerate(s.friction_aside):
        place = forward.nodes[axis] + state.displacements[axis]
        off = float((force * place).sum()) / total / (sides[axis] / 2)
        more += share * off**2
    return s.friction + more
