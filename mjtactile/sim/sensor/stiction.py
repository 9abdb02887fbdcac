"""Contact with memory: static friction without creep, and normal force without penetration.

MuJoCo's contacts are soft and have no memory. Below the friction cone, friction resists only a
velocity. A held object therefore sinks continuously. Along the normal, a force needs a depth.

Here a contact's rows carry only the *change* within a step. The previous force enters through their
reference. Along the normal this is the vertex's margin. Along the membrane it is the surface
velocity of its sphere (MuJoCo's conveyor belt). This velocity produces the previous friction. The
solver keeps friction inside its cone. Friction acts on both MuJoCo bodies, of any kind. This is the
method of multipliers (docs/theory/simulation_contact.md, C3; decision 10).

The arithmetic is in mjtactile/kernels/membrane_flex.c.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.kernels import bound
from mjtactile.sim.sensor.contact_list import listed

# Fractions of a step's error that are corrected in the next step. Half the value converges half as
# fast; twice the value oscillates.
_GIVE_FRACTION = 0.3
_SHIFT_FRACTION = 0.2
_KEPT = 0.5  # fraction of a remaining shift that is corrected when the contact slides on
# Friction target of a sliding contact beyond its cone, as a fraction of the limit. The solver's
# cone is convex: an excess also lifts the vertex. Without it, friction is 2 % too small.
_EXCESS = 0.1
_WAIT = 5e-3  # limit of the step, s, for updates every other step
_ON_CONE = 0.999  # of the cone: the solver's tolerance
# A slide stops when the mean speed of the sliding contacts falls below this fraction in one step.
# Friction of a single vertex varies in a steady slide; a vertex that then sticks for a step is
# lifted out of contact.
_SLOWER = 0.9
_LAPSE = 0.02  # time without any contact, s, after which the slide is forgotten
_JOINS = 2  # as in kernels/membrane_flex.c
_CHATTER_TIME = 0.04  # averaging time of the chatter, s
_LANDING = 0.12  # time after the first contact, s, in which an impact changes the force
_NOISE_GAIN = 6.0  # variance of the second difference of white noise, over that of the noise


class Stiction:
    """Memory of one sensor's vertex contacts. Call `update` before every step.

    A friction row gives f = -mass (v' - (1 - drag) v + drag s) / step, with the velocity v before
    the step, v' after it, and s of the surface. A sticking vertex should have v' = 0. Its friction
    also returns it to its initial sticking position. A sliding vertex should nearly keep its
    velocity, with friction on the edge of the cone. A vertex that makes contact while others slide
    moves with their mean velocity. A vertex that touches two objects at the same time remembers the
    force of one.
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
        # without sliding, an update in every other step suffices, at half the cost
        self._may_wait = self._step < _WAIT
        # motion of all coordinates since the last update, in steps
        self._travel = np.zeros(model.nv)
        # advance of the margin, m
        self._give = np.zeros(self._count)
        # per vertex: friction force on it in S, N; displacement relative to the sticking surface
        # since sticking started, m
        self._memory = np.zeros((self._count, 6))
        self._states = np.zeros(self._count, np.uint8)
        # mean speed and velocity (3,) in S of the sliding contacts, m/s; normal force, N
        self._slide = np.zeros(5)
        # normal forces of the last two updates, N; mean force, and variance from step to step
        self._normal = (0.0, 0.0)
        self._mean = 0.0
        self._variance = 0.0
        self._touched = np.nan  # time of the last contact, s
        self._landed = np.nan  # time of the first one, s
        self._belt = np.zeros((self._count, 3))
        fractions = (_SHIFT_FRACTION, _KEPT, _EXCESS, _ON_CONE, _GIVE_FRACTION, _SLOWER)
        settings = np.array([self._step, *fractions])
        vertices = (data.xmat[body_id], self._first, self._count)
        state = (self._give, self._memory, self._states, self._belt, self._slide)
        self._advance = bound("update_stiction", *[...] * 9, *vertices, settings, *state)
        model.flg_surfacevel = True
        self._forget()

    def update(self, stand_off: Array) -> None:
        """Store the contact forces of the last step. `stand_off` (k,) m is the intended
        distance."""
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
        if time < before:  # the clock was reset
            self._forget()
        if self._data.ncon and self._take():
            self._landed = time if self._empty else self._landed
            self._empty = False
            self._touched = time
        elif self._states.any() and time - self._touched < _LAPSE:
            self._lift()
        else:
            self._forget()
        np.add(stand_off, self._give, out=self._margins)
        self._travel[:] = 0.0

    def _take(self) -> bool:
        """Advance margins and surface velocities from the last contacts. Return True if any
        exist."""
        data = self._data
        velocity = np.empty(data.nefc)
        travel = np.empty(data.nefc)
        mujoco.mj_mulJacVec(self._model, data, velocity, data.qvel)
        mujoco.mj_mulJacVec(self._model, data, travel, self._travel)
        found = self._advance(
            *listed(data), data.nefc, data.efc_force, data.efc_KBIP, data.efc_R, velocity, travel
        )
        if not found:
            return False
        self._surface[:] = self._belt
        self._follow_force(float(self._slide[4]))
        return True

    def _follow_force(self, force: float) -> None:
        """Update mean and chatter of the normal `force`, N. A sliding contact that loses and
        regains vertices changes it in every step; a load changes it with a small curvature."""
        last, before = self._normal
        fraction = min(self._step / _CHATTER_TIME, 1.0)
        slides = self._states.any() and self._time - self._landed > _LANDING
        square = (force - 2 * last + before) ** 2 / _NOISE_GAIN if slides else 0.0
        self._variance += fraction * (square - self._variance)
        self._mean += fraction * (force - self._mean)
        self._normal = (force, last)

    @property
    def chatter(self) -> tuple[float, float]:
        """Standard deviation of the normal force from step to step, and its mean, N."""
        return float(np.sqrt(self._variance)), self._mean

    def _lift(self) -> None:
        """Keep only the velocity of the slide, for an object that is lifted for a short time."""
        self._give[:] = 0
        self._memory[:] = 0
        self._states[:] = _JOINS
        self._surface[:] = -self._slide[1:4]

    def _forget(self) -> None:
        if not self._empty:
            self._give[:] = 0
            self._memory[:] = 0
            self._states[:] = 0
            self._slide[:] = 0
            self._surface[:] = 0
            self._normal = (0.0, 0.0)
            self._mean = self._variance = 0.0
        self._empty = True
