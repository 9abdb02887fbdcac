"""Force correction for a membrane that sticks to an object, while the membrane model slides.

See docs/theory/contact_shape.md, Eq. F21.
"""

from __future__ import annotations

from mjtactile.quasistatic import MembraneSolution
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.settings import ContactShapeSettings


def sticks(forward: ForwardModel, state: MembraneSolution, s: ContactShapeSettings) -> float:
    """Return the ratio of the force with a sticking membrane to that of the model. The membrane is
    stretched more between the object and the nearer side of the frame. A sticking membrane cannot
    equalize this by sliding. The ratio is `friction` at the center and grows with the square of the
    pressure center's distance from there, in the frame's half-extents."""
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
