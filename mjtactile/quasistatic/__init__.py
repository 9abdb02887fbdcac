"""The film: what a pressed membrane does, for the price of a few sparse solves. Public face:
`mjtactile.QuasistaticMembrane`.

What it is. The sensor's sheet with its own rubber (neo-Hookean, pre-stretched) on a regular grid of
1 to 2 mm, which an outline that is no rectangle cuts (`cutting.py`), over its gas, at rest on
bodies that are heights over it. Nodes move in all three directions. Each step solves twice: for the
heights with a film's stiffness under the sheet's tension, and in the plane with one constant
matrix; residuals are the sheet's own, so that the result is the sheet's, not the matrices'. A state
goes on as it came (`MembraneSolution.trend`): bodies that move evenly want one step.

What it leaves out, and what that costs (docs/validation/benchmarks.md, `bench film`):
- Bending: nothing that a sheet of 0.3 mm shows, but for features narrower than about five
  thicknesses.
- Friction: 1 to 8 % of a force. Shear and torsion of what sticks are beside it (`sticking.py`): a
  patch is held by the sheet, and drags it along without changing what touches; its stiffness is
  within 10 %, from 16 mm of radius on within 4.
- Mass and damping: it is always at rest.
- What is undercut, or steeper than about 75 degrees: a body is seen along z alone (`bodies.py`);
  flanks of boxes and cylinders beyond 63 degrees are met at their edges only.
- What happens between nodes: a contact smaller than a few cells hangs on its place between them, a
  4 mm ball 0.5 mm deep by up to 14 % on nodes 2 mm apart, a thin rod by more; blades are met by the
  nearest line of nodes; ridges are a tenth too stiff there, and a cone's tip of 45 degrees a third
  too soft (most steeper ones are refused). `MembraneSolution.doubt` says
  how far 9 of 10 such forces are off at most (1: a tip that no node meets), `relative_area_error`
  areas, which are not known where a contact is a point or a line for the grid, and
  `QuasistaticMembrane.refined_for` finds a grid for a body: three times the time on 41 x 31 nodes.
  What is thinner than a tenth of the spacing may be missed, and needles slip aside.

What it refuses, in one line: what touches the rim, lies on the glass, pulls the sheet inside out
or beyond what its rubber's law is known for, or goes through between nodes. What does not converge
says so in `state.converged`, and its numbers are NaN.

Frame S, SI units; p V^gamma with the design's gamma, or a pressure that is held. Equations:
docs/theory/quasistatic_membrane.md, X1-X8. Why so: docs/decisions/0025-film.md.
"""

from mjtactile.quasistatic.membrane import QuasistaticMembrane
from mjtactile.quasistatic.obstacles import KINDS, Obstacle, obstacle
from mjtactile.quasistatic.sensitivities import SolutionSensitivities
from mjtactile.quasistatic.solution import MembraneSolution, MembraneStatus
from mjtactile.quasistatic.stick_contact import StickState, StuckPatch, drag

__all__ = [
    "KINDS",
    "MembraneSolution",
    "MembraneStatus",
    "Obstacle",
    "QuasistaticMembrane",
    "SolutionSensitivities",
    "StickState",
    "StuckPatch",
    "drag",
    "obstacle",
]  # fmt: skip
