"""What one film exerts on one body that touches it: normal force from the film, shear and torsion
from what sticks, and how stiff all that is against the body's motion.

Frame S; a body's motion is that of its material point at the contact's middle, and its turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjtactile.core import geometry
from mjtactile.core.types import Array
from mjtactile.film import Held, Patch, drag
from mjtactile.film.live import Grip, LiveFilm, Sticking

_LEAST = 1e-4  # N, below which nothing sticks
_CHANGED = 0.1  # share of the nodes that may come and go before the grip is found anew
_TILT = 0.25  # of stiffness times radius^2: of a disc on an even bed


@dataclass(frozen=True, eq=False)
class Stiffness:
    """Of a contact against small motions of its body: N/m along x, y and z of S, and N m about
    them, at `middle` (3,) m."""

    middle: Array
    along: Array
    about: Array


class FilmContact:
    """The contact of one film, and what sticks there remembers."""

    def __init__(self, live: LiveFilm, friction: float, sheet_stiffness: float):
        """`sheet_stiffness` Pa/m^3 is that of the bulge's pressure by its volume."""
        self._live = live
        self._friction = friction
        self._sheet = sheet_stiffness
        self._sticking = Sticking(live.film)
        self._half = math.sqrt(live.film.design.frame.area / math.pi)
        self._spacing = min(live.film.x[1] - live.film.x[0], live.film.y[1] - live.film.y[0])
        self.release()

    def release(self) -> None:
        """Nothing touches any more."""
        self._grip: Grip | None = None
        self._touched = np.zeros(0, bool)
        self._before = (self._live.x[0], self._live.x[1], np.zeros(self._live.force.shape, bool))
        self.held = Held.none()
        self.shear = np.zeros(3)
        """N along x and y, N m about z: of the body on the film."""
        self.middle = np.zeros(3)
        self.radius = 0.0
        self.slides = False

    def follow(self, moved: Array) -> None:
        """Take in that the body has `moved` since (6,): m of its point at the middle along S, and
        rad about its axes; after the film has come to rest."""
        live = self._live
        force = -float(live.wrench[2])
        if not force > _LEAST:
            self.release()
            return
        touched = live.force > 0
        grip = self._grip
        if grip is None or self._differs(touched):
            grip = self._grip = self._sticking.grip(live.x, live.force)
            self._touched = touched
        share = live.force[touched] / live.force.sum()
        i, j = np.nonzero(touched)
        film = live.film
        places = np.stack([film.x[i] + live.x[0, i, j], film.y[j] + live.x[1, i, j]], axis=1)
        place = share @ places
        off = places - place
        radius = float(share @ np.hypot(off[:, 0], off[:, 1]))
        self.middle = np.array([*place, share @ live.x[2, i, j]])
        self.radius = max(radius, 0.25 * self._spacing)
        # what sticks keeps its node from going where the frictionless film does
        both = touched & self._before[2]
        if both.any():
            kept = live.force[both] / live.force[both].sum()
            moved = moved.copy()
            moved[0] -= kept @ (live.x[0] - self._before[0])[both]
            moved[1] -= kept @ (live.x[1] - self._before[1])[both]
        self._before = (live.x[0].copy(), live.x[1].copy(), touched)
        patch = Patch(place, grip.stiffness, force, self.radius)
        load, held = drag(patch, self.held, (moved[0], moved[1], moved[5]), self._friction)
        self.slides = not np.array_equal(held.strain, self.held.strain + moved[[0, 1, 5]])
        self.held = held
        self.shear = -load

    def stiffness(self, gas_stiffness: float) -> Stiffness:
        """Against motions of the body; `gas_stiffness` Pa/m^3 is the gas's."""
        live = self._live
        radius = math.sqrt(max(live.area, self._spacing**2) / math.pi)
        wide = math.log(max(self._half / radius, 1.2))
        lifted = math.pi * (self._half**2 - radius**2) / (2 * wide)
        gas = 0.0
        if gas_stiffness > 0:
            gas = 1 / (1 / gas_stiffness + 1 / self._sheet)
        normal = 2 * math.pi * live.tension / wide + gas * lifted**2
        along = np.array([0.0, 0.0, normal])
        about = np.full(3, _TILT * normal * radius**2)
        if self._grip is not None and not self.slides and self._friction > 0:
            along[0] = self._grip.stiffness[0, 0]
            along[1] = self._grip.stiffness[1, 1]
            about[2] = self._grip.stiffness[2, 2]
        return Stiffness(self.middle, along, about)

    @property
    def wrench(self) -> Array:
        """(6,) of the body on the film about the origin of S, N and N m."""
        fx, fy, tz = self.shear
        force = np.array([fx, fy, 0.0])
        torque = geometry.cross(self.middle, force) + [0.0, 0.0, tz]
        return self._live.wrench + np.concatenate([force, torque])

    def spread(self) -> Array | None:
        """(2, inner) m by which what sticks has dragged the inner nodes; None: nothing sticks."""
        if self._grip is None:
            return None
        return self._grip.spread @ self.held.strain

    def _differs(self, touched: Array) -> bool:
        if touched.shape != self._touched.shape:
            return True
        return (touched != self._touched).sum() > _CHANGED * touched.sum()
