"""The rubber membrane as a MuJoCo flex: its MuJoCo bodies, pre-stretch and contact.

Every interior vertex is a small MuJoCo body on three slide joints *in the sensor's own frame S*, a
child of the sensor's body. The rim vertices belong to the sensor's body itself. Joint positions are
therefore displacements in S for any carrier (docs/theory/simulation_contact.md).
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.sensor_parts import Membrane
from mjtactile.sim.sensor.mesh import MembraneMesh

FLEX = "membrane"
TENDON = "gas"
BODY = "sensor"
ANYTHING = 0x7FFFFFFF
"""Value of `conaffinity` for contact with every geom that has a nonzero `contype`."""
RESERVED = 1 << 30
"""Bit of `contype` that only membranes and their housings have in their `conaffinity`."""

# Viscous resistance to membrane motion relative to the frame, N s/m per m^2 of membrane and per N/m
# of its stiffness (s/m^2). It models the rubber's internal friction and settles the shape in about
# 10 ms for any rubber. It also conditions the solver: it adds to the diagonal of the implicit
# system, which is almost empty for a membrane vertex of a few milligrams. Contact stiffness scales
# with that diagonal.
SURFACE_DAMPING = 27.0
# Multiple of this damping in the membrane plane. The membrane is that much stiffer there, so that
# shear settles as fast as a bulge. The implicit solve needs a quarter less time.
IN_PLANE_DAMPING = 3.0
SOFTEST = 100.0  # stiffness, N/m, below which the damping stays constant because of the gas
# Inertia against motion relative to the frame, kg/m^2, without weight: about three times the
# rubber's own mass.
SURFACE_ARMATURE = 0.8
GAS_FRACTION = 3.0  # pressure under a typical contact beyond the tension's, over the gas's
# Contact of triangles (MuJoCo `solimp`): impedance at first touch, final impedance, and the depth
# between the two. Without the ramp a barely touching vertex switches on and off between steps. At
# 13 x 11 vertices that doubled the solver's iterations and the noise of a held force.
SOLIMP = (0.99, 0.9995, 10e-6, 0.5, 2.0)
# Time constant of contact in steps: at 1 the solver takes twice the iterations.
CONTACT_TIME = 1.5
CONTACT_DEPTH = 20e-6
"""Contact depth, m, under a typical pressure. At 12 um the solver fails to converge for a free
plate of 20 g at a step of 4 ms."""
# Contact depth of vertices: minimum, m, and speed, m/s, multiplied by the step. It may exceed the
# depth of triangles because stiction.py compensates it. A larger speed change of a sliding contact
# within one step lifts vertices out of contact.
VERTEX_DEPTH = 160e-6
VERTEX_SPEED = 0.04
# Spring (times step squared) and dashpot (times step) of vertex contacts. The spring dominates, so
# that vertices stay in contact with a receding surface. MuJoCo's impedance is low enough not to
# limit the stiffness.
VERTEX_SPRING = 10.0
VERTEX_DASHPOT = 3.0
VERTEX_IMPEDANCE = 0.98


def add_membrane(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, design: SensorDesign, mesh: MembraneMesh
) -> None:
    """Add the flex, its vertex bodies with contact spheres, and the gas tendon under the sensor's
    `body`.

    Young's modulus is scaled by the square of the pre-stretch l. MuJoCo measures strain against the
    *mounted* mesh, E' = (L^2 - L0^2) / 2 L_mounted^2. This is 1/l^2 of the Green strain against the
    free membrane. It integrates over l^2 times the free membrane's area. The product leaves l^2.
    """
    names = _add_vertices(body, design.membrane, mesh)
    _add_flex(spec, design.membrane, mesh, names)
    # The chamber is a fixed tendon over the vertices' z joints, whose coefficients become dV/dz at
    # run time (chamber.py). MuJoCo's time for a tendon grows with the square of its joint count:
    # three axes would cost nine times as much without a benefit.
    tendon = spec.add_tendon(name=TENDON)
    tendon.stiffness = [1.0, 0.0, 0.0]
    tendon.springlength = [0.0, 0.0]
    for v in mesh.interior:
        tendon.wrap_joint(f"{names[v]}z", 1.0)


def _add_vertices(body: mujoco.MjsBody, membrane: Membrane, mesh: MembraneMesh) -> list[str]:
    """Add a MuJoCo body with three slides and a sphere for each moving vertex; return all names."""
    names = [BODY] * len(mesh.p_SV)
    mass = mesh.areas * membrane.thickness * membrane.density / membrane.pre_stretch**2
    damping = mesh.areas * SURFACE_DAMPING * membrane_stiffness(membrane)
    armature = mesh.areas * SURFACE_ARMATURE
    for v in mesh.interior:
        names[v] = f"v{v}"
        vertex = body.add_body(name=names[v], pos=mesh.p_SV[v])
        vertex.mass = mass[v]
        vertex.inertia = [max(mass[v] * 1e-8, 1e-14)] * 3
        vertex.explicitinertial = True
        # else MuJoCo takes `pos` for it, and leaves the inertia out when it saves XML
        vertex.ipos = [0.0, 0.0, 0.0]
        for axis, direction in zip("xyz", np.eye(3), strict=True):
            vertex.add_joint(
                name=names[v] + axis,
                type=mujoco.mjtJoint.mjJNT_SLIDE,
                axis=direction,
                damping=[damping[v] * (1.0 if axis == "z" else IN_PLANE_DAMPING), 0.0, 0.0],
                armature=armature[v],
            )
        _add_contact_sphere(vertex, names[v], membrane.thickness / 2, membrane.friction)
    return names


def _add_flex(
    spec: mujoco.MjSpec, membrane: Membrane, mesh: MembraneMesh, names: list[str]
) -> None:
    """Add the flex of the rubber with its contacts switched off."""
    flex = spec.add_flex(name=FLEX)
    flex.dim = 2
    flex.radius = membrane.thickness / 2
    flex.thickness = membrane.thickness
    flex.young = membrane.young * membrane.pre_stretch**2
    flex.poisson = membrane.poisson
    flex.damping = 1e-9
    flex.elastic2d = 2  # stretching only: bending matters below about five thicknesses
    flex.vertbody = names
    flex.elem = mesh.triangles.ravel().tolist()
    local = mesh.p_SV.copy()
    local[mesh.interior] = 0.0  # these vertices are at the origins of their own MuJoCo bodies
    flex.vert = local.ravel().tolist()
    # vertex spheres touch; see `touch_with`
    flex.selfcollide = 0
    flex.contype = 0
    flex.conaffinity = 0
    flex.condim = 3
    flex.priority = 1
    flex.friction = [membrane.friction, 0.005, 0.0001]
    flex.solimp = SOLIMP
    flex.rgba = [0.92, 0.92, 0.9, 1.0]


def _add_contact_sphere(vertex: mujoco.MjsBody, name: str, radius: float, friction: float) -> None:
    """Add a sphere that collides with any contype, with the membrane's own friction and
    stiffness."""
    vertex.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[radius, 0, 0],
        mass=0.0,
        contype=0,
        conaffinity=ANYTHING,
        priority=1,
        condim=3,
        friction=[friction, 0.005, 0.0001],
        solimp=SOLIMP,
        group=4,
    )


def membrane_stiffness(membrane: Membrane) -> float:
    """Return the stiffness, N/m, that sets damping and contact stiffness: stretching or bulging."""
    return max(membrane.young * membrane.thickness, 10 * membrane.pretension, SOFTEST)


def contact_pressure(membrane: Membrane, gauge_pressure: float) -> float:
    """Estimate a typical contact pressure, Pa: tension over a radius of about 10 mm, plus the
    gas."""
    return membrane_stiffness(membrane) / 0.04 + GAS_FRACTION * abs(gauge_pressure)


class ContactStiffness:
    """Contact stiffness adapted to pressure and tension.

    Under `contact_pressure` a vertex penetrates to a fixed depth. MuJoCo's contact softness is
    proportional to the compiled `body_invweight0` of the MuJoCo bodies. The factor M / (M + h D) of
    their joints multiplies it. The values of the vertices are set accordingly. The force on a
    vertex is (stiffness per area) x (its area) x (depth), for any step h and damping D. The
    solver's effort depends on the ratio of this stiffness to the damping, which is the same for all
    rubbers. See `CONTACT_DEPTH`, and `VERTEX_DEPTH` for a membrane that `remembers`.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        vertex_geom_ids: np.ndarray,
        flex_id: int,
        mesh: MembraneMesh,
        membrane: Membrane,
        *,
        remembers: bool,
    ):
        step = float(model.opt.timestep)
        self._contact_pressure = contact_pressure(membrane, 0.0)
        bodies = model.geom_bodyid[vertex_geom_ids]
        # one block, in the mesh's order
        self._weights = np.asarray(model.body_invweight0)[bodies[0] : bodies[-1] + 1, 0]
        if remembers:
            depth = max(VERTEX_DEPTH, VERTEX_SPEED * step)
            spring = VERTEX_SPRING / step**2
            fraction = VERTEX_IMPEDANCE
            model.geom_solref[vertex_geom_ids] = (
                -fraction * spring,
                -fraction * VERTEX_DASHPOT / step,
            )
            model.geom_solimp[vertex_geom_ids] = (fraction, fraction, *SOLIMP[2:])
        else:
            time = CONTACT_TIME * step
            depth = CONTACT_DEPTH
            spring = 1 / time**2
            fraction = SOLIMP[1]
            model.geom_solref[vertex_geom_ids] = model.flex_solref[flex_id] = (time, 1.0)
        # kg/m^2
        inertia = SURFACE_ARMATURE + membrane.thickness * membrane.density / membrane.pre_stretch**2
        slowed = 1 + step * SURFACE_DAMPING * membrane_stiffness(membrane) / inertia
        self._soft = fraction / (1 - fraction) * slowed * depth * spring / mesh.areas[mesh.interior]

    def set_pressure(self, gauge_pressure: float) -> None:
        np.divide(
            self._soft,
            self._contact_pressure + GAS_FRACTION * abs(gauge_pressure),
            out=self._weights,
        )


def touch_with(model: mujoco.MjModel, vertex_geom_ids: np.ndarray, flex_id: int, mode: str) -> None:
    """Enable contacts at the membrane's "vertices", its triangles ("elements"), or "both"."""
    model.geom_conaffinity[vertex_geom_ids] = ANYTHING * (mode != "elements")
    model.flex_conaffinity[flex_id] = ANYTHING * (mode != "vertices")


def pre_stretch(model: mujoco.MjModel, flex_id: int, mesh: MembraneMesh, stretch: float) -> None:
    """Shorten the flex's free edge lengths so that the mounted mesh is stretched by `stretch`."""
    start = int(model.flex_edgeadr[flex_id])
    count = int(model.flex_edgenum[flex_id])
    edges = np.asarray(model.flex_edge)[start : start + count]
    mounted = np.linalg.norm(mesh.p_SV[edges[:, 1]] - mesh.p_SV[edges[:, 0]], axis=1)
    model.flexedge_length0[start : start + count] = mounted / stretch
