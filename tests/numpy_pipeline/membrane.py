"""The stages of mjtactile/kernels/membrane_flex.c in numpy: gas volume, rubber, contact that
remembers."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.neo_hookean import shear_modulus, thickness_over_area
from mjtactile.core.sensor_parts import Membrane
from mjtactile.core.types import Array
from mjtactile.sim.sensor.mesh import MembraneMesh
from mjtactile.sim.sensor.rubber_flex import EdgeMatrices

_UPPER = np.triu_indices(3)
_FLATTEST = 1e-2  # least det C: a triangle that collapses keeps a finite stress
_UNSTRAINED = 1e-6  # of tr E: below, the moduli are those of no strain
# lambda' in mu' and in the unstrained one
_LOW = -0.5
_HIGH = 3.0


def volume_and_gradient(mesh: MembraneMesh, p_SV: Array) -> tuple[float, Array]:
    """Return V (m^3) over the flat membrane and dV/dp (k, 3) m^2 at the interior vertices."""
    a, b, c = (p_SV[mesh.triangles[:, i]] for i in range(3))
    area = 0.5 * np.cross(b - a, c - a)
    gradient = np.zeros_like(p_SV)
    for i in range(3):
        np.add.at(gradient, mesh.triangles[:, i], area / 3)
    return float(np.vdot(a + b + c, area)) / 9, gradient[mesh.interior]


def stiffness(
    model: mujoco.MjModel, flex_id: int, mesh: MembraneMesh, membrane: Membrane, p_SV: Array
) -> Array:
    """Return rows (m, 6) of MuJoCo's stiffness at the strain of vertices at `p_SV` (n, 3), m."""
    elements = EdgeMatrices(model, flex_id, mesh)
    edges = (p_SV[elements.ends[:, 1]] - p_SV[elements.ends[:, 0]])[elements.edges]
    C = np.einsum("mij,mj->im", elements.metric * membrane.pre_stretch**2, (edges**2).sum(axis=2))
    trace = (C[0] + C[1]) / 2 - 1
    modulus = shear_modulus(membrane.young, membrane.poisson)
    first = 2 * modulus * membrane.poisson / (1 - membrane.poisson)
    mu = modulus * thickness_over_area(
        np.log(np.maximum(C[0] * C[1] - C[2] ** 2, _FLATTEST)), membrane.poisson
    )
    unstrained = np.abs(trace) < _UNSTRAINED
    secant = (modulus - mu * (1 + 2 * trace)) / np.where(unstrained, 1.0, trace)
    second = np.where(unstrained, first, np.clip(secant, _LOW * mu, _HIGH * first))
    volume = mesh.triangle_areas * membrane.thickness * membrane.pre_stretch**2 / 2
    trace = elements.metric[:, 0] + elements.metric[:, 1]
    shear = elements.metric.transpose(0, 2, 1) @ np.diag([2.0, 2.0, 4.0]) @ elements.metric
    full = mu[:, None, None] * shear + second[:, None, None] * trace[:, :, None] * trace[:, None, :]
    return volume[:, None] * full[:, _UPPER[0], _UPPER[1]]


# Shares of a step's error that are mended in the next step. Half as much is half as fast; twice as
# much rings.
_GIVE_FRACTION = 0.3
_SHIFT_FRACTION = 0.2
_KEPT = 0.5  # of a shift that is still to be mended when the contact slides on
# Friction target of a sliding contact beyond its cone, as a fraction of the limit. The solver's
# cone is convex: an excess also lifts the vertex. Without it, friction is 2 % too small.
_EXCESS = 0.1
_WAIT = 5e-3  # time step, s; two longer steps are too long
_ON_CONE = 0.999  # of the cone: the solver's tolerance
_TINY = 1e-24  # in place of zero in a denominator or under a root
# a slide stops when the mean speed of the sliding contacts falls below this fraction in one step
_SLOWER = 0.9
_LAPSE = 0.02  # time without any contact, s, after which the slide is forgotten
_STICKS, _SLIDES, _JOINS = range(3)
_TWO = np.array([[1], [2]])  # the rows of friction after that of the normal


class _Contacts(NamedTuple):
    """The `n` contacts with friction of the last step, per vertex; vectors by components in their
    tangent planes."""

    vertices: NDArray[np.int64]
    axes: Array  # (2, 3, n) the planes' axes in S
    friction: Array  # (2, n) N on the vertex
    velocity: Array  # relative velocity after the step (2, n), m/s
    travel: Array  # displacement since the last update (2, n), m
    limit: Array  # (n,) N, of friction
    mass: Array  # (n,) kg: friction changes by this times a change of velocity over a step's length
    drag: Array  # (n,): the fraction of the normal velocity that a step removes


class Stiction:
    """Memory of one sensor's vertex contacts. Call `update` before every step.

    A vertex in contact with two geoms at once remembers only one of the contacts.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        vertex_geom_ids: NDArray[np.int64],
        body_id: int,
    ):
        self._model = model
        self._data = data
        self._body = body_id
        # one block, in the mesh's order
        self._first = int(vertex_geom_ids[0])
        self._count = len(vertex_geom_ids)
        block = slice(self._first, self._first + self._count)
        # live views
        self._margins = model.geom_margin[block]
        self._surface = model.geom_surfacevel[block, :3]
        self._step = float(model.opt.timestep)
        self._time = np.nan
        self._empty = False
        self._waits = False
        # every second step is sufficient without sliding, at half the cost
        self._may_wait = self._step < _WAIT
        # displacement of all coordinates since the last update, divided by the step
        self._travel = np.zeros(model.nv)
        self._give = np.zeros(self._count)  # advance of the margin, m
        self._held = np.zeros((3, self._count))  # friction on the vertex, N, frame S
        # displacement relative to the touched surface since sticking started, m
        self._shift = np.zeros((3, self._count))
        self._states = np.zeros(self._count, np.int64)
        self._speed = 0.0  # mean speed of the sliding contacts, m/s
        self._slip = np.zeros(3)  # their mean velocity in S, m/s
        self._touched = np.nan  # time of the last contact, s
        model.flg_surfacevel = True
        self._forget()

    def update(self, stand_off: Array) -> None:
        """Update the memory from the contacts of the last step; `stand_off` (k,) m is the contact
        distance of the vertices."""
        time = float(self._data.time)
        before = self._time
        if time == before:
            return
        self._time = time
        self._travel += self._data.qvel
        self._waits = (
            self._may_wait and not self._waits and time > before and not self._states.any()
        )
        if self._waits:
            return
        if time < before:  # the clock was set back
            self._forget()
        rows, sides, vertices = self._find()
        if len(rows):
            self._empty = False
            self._touched = time
            self._take_normal(rows, vertices)
            rough = self._data.contact.dim[rows] >= 3
            if rough.all():
                self._take_friction(self._contacts(rows, sides, vertices))
            elif rough.any():
                self._take_friction(self._contacts(rows[rough], sides[rough], vertices[rough]))
            else:
                self._clear()
        elif self._states.any() and time - self._touched < _LAPSE:
            self._give[:] = 0
            self._clear()
            self._states[:] = _JOINS
            self._surface[:] = -self._slip
        else:
            self._forget()
        np.add(stand_off, self._give, out=self._margins)
        self._travel[:] = 0.0

    def _find(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return rows of MuJoCo's contact list with vertices; the side of the vertex in each, 0 or
        1; the vertices."""
        contact = self._data.contact
        numbers = contact.geom - self._first  # of the vertices, or out of range
        own = (numbers >= 0) & (numbers < self._count)
        rows = ((own[:, 0] | own[:, 1]) & (contact.efc_address >= 0)).nonzero()[0]
        sides = own[rows, 1].astype(np.int64)
        return rows, sides, numbers[rows, sides]

    def _take_normal(self, rows: NDArray[np.int64], vertices: NDArray[np.int64]) -> None:
        """Advance the margins by the depths of the contacts, so that vertices come to rest at
        contact. They retract by at most a part of the remaining depth."""
        contact = self._data.contact
        goal = np.zeros(self._count)
        velocity = np.empty(self._data.nefc)
        mujoco.mj_mulJacVec(self._model, self._data, velocity, self._data.qvel)
        depth = contact.includemargin[rows] - contact.dist[rows]
        left = depth - self._step * velocity[contact.efc_address[rows]]
        goal[vertices] = np.maximum(
            np.maximum(depth, 0.0), self._give[vertices] - np.maximum(left, 0.0)
        )
        self._give += _GIVE_FRACTION * (goal - self._give)

    def _contacts(
        self, rows: NDArray[np.int64], sides: NDArray[np.int64], vertices: NDArray[np.int64]
    ) -> _Contacts:
        data = self._data
        contact = self._data.contact
        normal_rows = contact.efc_address[rows]
        rows_along = normal_rows + _TWO
        velocity = np.empty(data.nefc)
        travel = np.empty(data.nefc)
        mujoco.mj_mulJacVec(self._model, data, velocity, data.qvel)
        mujoco.mj_mulJacVec(self._model, data, travel, self._travel)
        axes = contact.frame[rows, 3:].reshape(-1, 3) @ data.xmat[self._body].reshape(3, 3)
        # MuJoCo's signs are those of the second geom
        axes = axes.reshape(-1, 2, 3).transpose(1, 2, 0) * (2 * sides - 1)
        force = data.efc_force
        coefficient = contact.friction[rows, 0]
        normal = force[normal_rows]
        damping = self._step * data.efc_KBIP[normal_rows + 1, 1]
        return _Contacts(
            vertices,
            axes,
            force[rows_along],
            velocity[rows_along],
            self._step * travel[rows_along],
            coefficient * normal,
            1 / data.efc_R[normal_rows + 1],
            damping / (1 + damping),
        )

    def _take_friction(self, c: _Contacts) -> None:
        """Set the surface velocities with which friction starts the next step at its last value.

        A row gives f = -mass (v' - (1 - drag) v + drag s) / step, with the velocities v before and
        v' after the step, and s of the surface. A sticking vertex should have v' = 0 and a friction
        force that also returns it to its initial sticking point. A sliding vertex should nearly
        keep its velocity, with friction on the edge of the cone. A vertex that joins a slide moves with its
        mean velocity.
        """
        step = self._step
        states = self._states[c.vertices]
        slid = states == _SLIDES
        was = _in_plane(self._held, c)
        speeds = np.sqrt(_dot(c.velocity, c.velocity))[slid]
        speed = float(speeds.mean()) if len(speeds) else 0.0
        slows = speed < _SLOWER * self._speed
        # friction if it stuck
        tried = np.where(slid, was, c.friction) - c.mass / step * c.velocity
        on_cone = _dot(c.friction, c.friction) >= (_ON_CONE * c.limit) ** 2
        starts = np.where(
            states == _JOINS,
            _dot(tried, tried) >= c.limit**2,
            on_cone & (_dot(c.friction, c.velocity) <= 0),
        )
        slides = np.where(slid, (_dot(was, c.velocity) < 0) & (not slows), starts)
        held = np.where(slid & ~slides, _shorten(was, c.limit), c.friction)
        shift = _in_plane(self._shift, c)
        shift = np.where(slides, _KEPT * shift, shift + c.travel)
        target = (1 + _EXCESS) * c.limit
        back = held - (_SHIFT_FRACTION / step**2 * c.mass) * shift
        along = target / np.sqrt(np.maximum(_dot(tried, tried), _TINY)) * tried
        held = np.where(slides, along, _shorten(back, target))
        surface = np.where(slides, -c.drag, 1 - c.drag) * c.velocity - (step / c.mass) * held
        self._clear()
        self._speed = speed
        self._slip = np.zeros(3)
        if slides.any():
            self._slip = _in_space(c.velocity, c)[:, slides].mean(axis=1)
            self._states[:] = _JOINS
            self._surface[:] = -self._slip
        self._states[c.vertices] = np.where(slides, _SLIDES, _STICKS)
        self._held[:, c.vertices] = _in_space(held, c)
        self._shift[:, c.vertices] = _in_space(shift, c)
        self._surface[c.vertices] = _in_space(surface / c.drag, c).T

    def _clear(self) -> None:
        self._held[:] = 0
        self._shift[:] = 0
        self._states[:] = _STICKS
        self._surface[:] = 0

    def _forget(self) -> None:
        if not self._empty:
            self._give[:] = 0
            self._speed = 0.0
            self._slip = np.zeros(3)
            self._clear()
        self._empty = True


def _in_plane(memory: Array, c: _Contacts) -> Array:
    """Return components (2, n) in the contacts' planes of the `memory` (3, k) of all vertices, in
    S."""
    return (c.axes * memory[:, c.vertices]).sum(axis=1)


def _in_space(vectors: Array, c: _Contacts) -> Array:
    """Return components (3, n) in S of `vectors` (2, n) in the contacts' planes."""
    return c.axes[0] * vectors[0] + c.axes[1] * vectors[1]


def _dot(a: Array, b: Array) -> Array:
    return a[0] * b[0] + a[1] * b[1]


def _shorten(vectors: Array, maximum: Array) -> Array:
    """Return the vectors (2, n), limited to the length `most` (n,)."""
    return vectors * np.minimum(maximum / np.sqrt(np.maximum(_dot(vectors, vectors), _TINY)), 1.0)
