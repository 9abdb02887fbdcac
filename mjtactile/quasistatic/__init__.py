"""Quasi-static membrane solver: the equilibrium of a loaded membrane in a few sparse solves.

Public interface: `mjtactile.QuasistaticMembrane`.

Model. The sensor's membrane has its own rubber (neo-Hookean, pre-stretched) and covers the chamber
gas. The grid is regular with a spacing of 1 to 2 mm. A non-rectangular outline cuts grid cells
(`cut_cells.py`). The membrane is in equilibrium on obstacles, which are height fields over it.
Nodes move in all three directions. Each step has two solves. The heights use the stiffness of a
tensioned membrane, the in-plane displacements use one constant matrix. The residuals are those of
the full membrane model. The matrices therefore affect convergence but not the result. The solver
extrapolates the last change of the state (`MembraneSolution.trend`). Obstacles in steady motion
therefore need one step.

Limits and their cost (docs/validation/benchmarks/quasistatic.md):
- Bending is neglected. For a membrane of 0.3 mm this matters only for features narrower than about
  five thicknesses.
- Contact is frictionless, an error of 1 to 8 % of the force. Shear and torsion of sticking contact
  are a separate model (`stick_contact.py`). It moves a patch against the membrane's stiffness
  without a change of the contact region. Its stiffness is within 10 %, and within 4 % from a radius
  of 16 mm on.
- Mass and damping are neglected: the membrane is always in equilibrium.
- Obstacles are height fields along z (`obstacles.py`). Undercuts and slopes steeper than about 75
  degrees are not represented. Flanks of boxes and cylinders beyond 63 degrees are in contact at
  their edges only.
- Contact is evaluated at nodes only. A contact smaller than a few cells depends on its position
  between the nodes. The force of a 4 mm ball 0.5 mm deep varies by up to 14 % on nodes 2 mm apart.
  That of a thin rod varies by more. Blades are in contact with the nearest line of nodes. Ridges
  are 10 % too stiff there. The tip of a 45 degree cone is a third too soft. Most steeper cones are
  rejected. `MembraneSolution.relative_force_error` is the bound that holds for 9 of 10 such forces.
  It is 1 for a tip without contact at any node. `relative_area_error` is that of areas. The area is
  unknown if the contact is a point or a line on this grid. `QuasistaticMembrane.refined_for`
  selects a grid for an obstacle. 41 x 31 nodes take three times as long. Obstacles thinner than a
  tenth of the spacing may be missed, and needles slip aside.

The solver rejects some obstacles with a one-line error. Such an obstacle touches the rim, lies on
the glass, or passes between nodes. It also rejects an inverted membrane, and stretch beyond the
range of the material model. If a solution does not converge, `state.converged` is False and its
values are NaN.

Frame S, SI units. The gas follows p V^gamma with the design's gamma, or its pressure is held.
Equations: docs/theory/quasistatic_membrane.md, X1-X8.
Rationale: docs/decisions/0025-quasistatic-membrane.md.
"""

from mjtactile.quasistatic.membrane import QuasistaticMembrane
from mjtactile.quasistatic.obstacles import KINDS, Obstacle, obstacle
from mjtactile.quasistatic.sensitivities import SolutionSensitivities
from mjtactile.quasistatic.solution import MembraneSolution, MembraneStatus
from mjtactile.quasistatic.stick_contact import StuckPatch

__all__ = [
    "KINDS",
    "MembraneSolution",
    "MembraneStatus",
    "Obstacle",
    "QuasistaticMembrane",
    "SolutionSensitivities",
    "StuckPatch",
    "obstacle",
]  # fmt: skip
