"""`TactileSensor`: one attached sensor at run time. Call `update` before every `mj_step`; read markers and pressure."""

from __future__ import annotations

import mujoco
import numpy as np

from mjtactile.design import SensorDesign
from mjtactile.errors import InputError
from mjtactile.sim.chamber import ChamberGeometry, Gas, GasTendon
from mjtactile.sim.membrane import FLEX, TENDON, MarkerInterpolator, MembraneMesh, pre_stretch
from mjtactile.types import Array

GLASS_MARGIN = 0.02
"""Share of the chamber's depth in front of the glass that the membrane may not enter."""


class TactileSensor:
    """Runtime of one sensor in a compiled model: gas, valve, marker poses.

    Positions are in the sensor's frame S, in m; pressures in Pa above ambient; volumes in m^3. The valve starts open
    to a supply at 0 Pa, so that the membrane starts, and stays, flat.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, design: SensorDesign, mesh: MembraneMesh,
                 prefix: str):
        self.design, self.mesh, self.prefix = design, mesh, prefix
        self.flex_id = _require(model, mujoco.mjtObj.mjOBJ_FLEX, prefix + FLEX)
        self.body_id = _require(model, mujoco.mjtObj.mjOBJ_BODY, prefix + "sensor")
        names = [f"{prefix}v{v}" for v in mesh.interior]
        self.vertex_geom_ids = np.array([_require(model, mujoco.mjtObj.mjOBJ_GEOM, name) for name in names])
        pre_stretch(model, self.flex_id, mesh, design.membrane.pre_stretch)
        model.flex_damping[self.flex_id] = 0.0  # a trace is needed to compile without a warning, none to simulate
        # Time constant of contact: at 1 step it takes twice the iterations, at 2 objects sink in 1.7 times as deep.
        model.geom_solref[self.vertex_geom_ids] = (1.5 * model.opt.timestep, 1.0)
        self._tendon = GasTendon(model, data, _require(model, mujoco.mjtObj.mjOBJ_TENDON, prefix + TENDON))
        self._geometry = ChamberGeometry(mesh, design.chamber_volume_flat)
        self._markers = MarkerInterpolator(mesh, design.markers.p_SM)
        self._gas = Gas(design.chamber.ambient, design.chamber.heat_ratio)
        self.update()

    def update(self) -> None:
        """Bring gas volume, pressure and stiffness up to the present state; call before every `mj_step`."""
        self._volume, gradient = self._geometry.volume_and_gradient(self.p_SV)
        self._pressure, stiffness = self._gas.pressure_and_stiffness(self._volume)
        self._tendon.apply(self._pressure, stiffness, gradient)

    @property
    def p_SV(self) -> Array:
        """Vertex positions (n, 3) m in S, rim included, now (not one step old like `flexvert_xpos`)."""
        p_SV = self.mesh.p_SV.copy()
        p_SV[self.mesh.interior] += self._tendon.displacements.reshape(-1, 3)
        return p_SV

    def marker_poses(self) -> tuple[Array, Array]:
        """Marker centres `p_SM` (N, 3) m and outward unit normals `n_S` (N, 3), in the order of the design's layout."""
        return self._markers.marker_poses(self.p_SV)

    def height_at(self, x: float, y: float) -> float:
        """Height, m, of the material point (x, y) of the flat sheet, from the spline that carries the markers."""
        return float(MarkerInterpolator(self.mesh, np.array([[x, y, 0.0]])).marker_poses(self.p_SV)[0][0, 2])

    def stretch_and_area(self) -> tuple[float, float]:
        """Largest principal stretch against the free sheet over all triangles, and the membrane's area, m^2."""
        flat, now = self.mesh.p_SV[self.mesh.triangles], self.p_SV[self.mesh.triangles]
        edges, moved = flat[:, 1:, :2] - flat[:, :1, :2], now[:, 1:] - now[:, :1]
        F = np.linalg.solve(edges, moved)  # rows: dx/dX and dx/dY, (m, 2, 3)
        largest = np.linalg.eigvalsh(F @ F.transpose(0, 2, 1))[:, 1].max()
        area = 0.5 * np.linalg.norm(np.cross(moved[:, 0], moved[:, 1]), axis=1).sum()
        return self.design.membrane.pre_stretch * float(np.sqrt(largest)), float(area)

    @property
    def pressure_gauge(self) -> float:
        """Gauge pressure in the chamber, Pa, at the last `update`."""
        return self._pressure

    @property
    def volume(self) -> float:
        """Gas volume, m^3, at the last `update`."""
        return self._volume

    @property
    def valve_is_open(self) -> bool:
        return self._gas.is_open

    def open_valve(self, supply_gauge: float | None = None) -> None:
        """Connect the chamber to a supply at `supply_gauge` Pa (default: the design's); the pressure follows at once."""
        self._gas.open(self.design.chamber.supply_gauge if supply_gauge is None else supply_gauge)

    def close_valve(self) -> None:
        """Trap the gas that is in the chamber now."""
        self.update()
        self._gas.close(self._volume)

    def failure(self) -> str | None:
        """Say why this sensor's state is outside what the model describes, or None."""
        moved = self._tendon.displacements
        depth = self.design.chamber.depth
        if moved[2::3].min() < -(1 - GLASS_MARGIN) * depth:
            return f"sensor {self.prefix!r}: the membrane is pushed against the glass ({depth * 1e3:g} mm deep)"
        if self._volume <= 0:
            return f"sensor {self.prefix!r}: the chamber has no volume left"
        reach = 2 * max(self.design.frame.length, self.design.frame.width)
        if max(moved.max(), -moved.min()) > reach:
            return f"sensor {self.prefix!r}: the membrane has moved by more than {reach * 1e3:g} mm"
        return None


def _require(model: mujoco.MjModel, kind: mujoco.mjtObj, name: str) -> int:
    found = mujoco.mj_name2id(model, kind, name)
    if found < 0:
        raise InputError(f"the model has no {kind.name.removeprefix('mjOBJ_').lower()} {name!r}; was it compiled from "
                         "the spec that the sensor was attached to?", source="bind", field="model")
    return found
