"""`BaseSensor`: common part of all run-time sensors: markers on a membrane, and a gas chamber."""

from __future__ import annotations

from abc import ABC, abstractmethod

import mujoco
import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.flags import Reasons
from mjtactile.core.not_copyable import NotCopyable
from mjtactile.core.types import Array
from mjtactile.sim.sensor.effect_switches import make_gas
from mjtactile.sim.sensor.gas import ChamberGas
from mjtactile.sim.sensor.membrane import BODY
from mjtactile.sim.sensor.mesh import MarkerInterpolator, MembraneMesh


class BaseSensor(NotCopyable, ABC):
    """Run-time state of one sensor in a compiled model, except its membrane.

    Positions are in the sensor's frame S, in m; pressures in Pa above ambient; volumes in m^3. The
    valve starts open to a supply at 0 Pa, so that the membrane stays flat. Raises InputError if the
    model has no such sensor.
    """

    REMEDY = "bind the sensor to the copied model and data"

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        design: SensorDesign,
        mesh: MembraneMesh,
        prefix: str,
        effects: frozenset[str],
    ):
        self.design = design
        self.mesh = mesh
        self.prefix = prefix
        self._data = data
        self._timestep = float(model.opt.timestep)
        self.body_id = require(model, mujoco.mjtObj.mjOBJ_BODY, prefix + BODY)
        first = int(model.body_geomadr[self.body_id])
        self.housing_geom_ids = np.arange(first, first + int(model.body_geomnum[self.body_id]))
        """The sensor's frame, glass and camera block."""
        self._markers = MarkerInterpolator(mesh, design.markers.p_SM)
        self._gas = make_gas(design.chamber, effects)
        self.sleepy = True
        """True if the sensor may sleep while no object is near and the scene is at rest
        (sleep.py)."""

    @property
    @abstractmethod
    def p_SV(self) -> Array:
        """Vertex positions (n, 3) m in S, rim included, now."""

    @abstractmethod
    def _update_to_now(self) -> None:
        """Update membrane and gas to the present state, awake, before the valve is moved."""

    @property
    @abstractmethod
    def friction(self) -> float:
        """Friction coefficient of the membrane with other bodies, now."""

    @abstractmethod
    def set_friction(self, friction: float) -> None:
        """Change the friction coefficient, as water or oil does, from the next step on."""

    def wake(self) -> None:
        """Resume from the state in which the sensor fell asleep, as after a change of the model."""

    def _gas_now(self) -> ChamberGas:
        """Return the gas at the membrane's present volume, without side effects on the state."""
        return self._gas

    @property
    def time(self) -> float:
        """Simulated time now, s."""
        return float(self._data.time)

    # -- the membrane

    def marker_poses(self) -> tuple[Array, Array]:
        """Return marker centers `p_SM` (N, 3) m and unit normals `n_S` (N, 3) in the layout's
        order."""
        return self._markers.marker_poses(self.p_SV)

    def height_at(self, x: float, y: float) -> float:
        """Return the height of the material point (x, y) by the spline that carries the markers,
        m."""
        at = MarkerInterpolator(self.mesh, np.array([[x, y, 0.0]]))
        return float(at.marker_poses(self.p_SV)[0][0, 2])

    def stretches(self) -> tuple[Array, Array]:
        """Return principal stretches (m, 2), small and large, relative to the free membrane, and
        areas (m,) m^2 of the triangles."""
        return self.mesh.stretches(self.p_SV, self.design.membrane.pre_stretch)

    def stretch_and_area(self) -> tuple[float, float]:
        """Return the largest principal stretch of the triangles and the membrane's area, m^2."""
        stretches, areas = self.stretches()
        return float(stretches.max()), float(areas.sum())

    # -- the chamber

    @property
    def gauge_pressure(self) -> float:
        """Gauge pressure in the chamber, Pa, at the last `update`."""
        return self._gas_now().gauge_pressure

    @property
    def temperature(self) -> float:
        """Temperature of the gas in the chamber, K, at the last `update`."""
        return self._gas_now().temperature

    @property
    @abstractmethod
    def volume(self) -> float:
        """Gas volume, m^3, at the last `update`."""

    @property
    def valve_is_open(self) -> bool:
        return self._gas.is_open

    def open_valve(self, supply_gauge: float | None = None) -> None:
        """Connect the chamber to a supply at `supply_gauge` Pa (default: the design's)."""
        self._update_to_now()
        self._gas.open(self.design.chamber.supply_gauge if supply_gauge is None else supply_gauge)

    def close_valve(self) -> None:
        """Close the valve and seal the current gas."""
        self._update_to_now()
        self._gas.close()

    def puncture(self, conductance: float) -> None:
        """Make a hole to ambient of `conductance` m^3/(s Pa); 0 mends it."""
        self.wake()
        self._gas.puncture(conductance)

    def warm(self, rate: float) -> None:
        """Warm gas and walls by `rate`, K/s, from now on."""
        self.wake()
        self._gas.warm(rate)

    def unsolved_flags(self) -> Reasons:
        """Return flags of the last step that are due at once."""
        return {}

    def _empty(self) -> str | None:
        """Return the failure message of a chamber without gas; None if it has some."""
        if self.volume > 0:
            return None
        return f"sensor {self.prefix!r}: the chamber has no volume left"


def require(model: mujoco.MjModel, kind: mujoco.mjtObj, name: str) -> int:
    """Return the id of a sensor element in its model. Raise InputError if it is missing."""
    found = mujoco.mj_name2id(model, kind, name)
    if found < 0:
        raise InputError(
            f"the model has no {kind.name.removeprefix('mjOBJ_').lower()} {name!r}; compile "
            "it from the spec to which the sensor was attached",
            source="bind",
            field="model",
        )
    return found
