"""`QuasistaticSensor`: a sensor with a quasi-static membrane outside MuJoCo's model.

Its interface is that of `TactileSensor`. The membrane rests on the obstacles at their present poses
(`mjtactile.quasistatic`), sticks to them and slides by Coulomb's law. It applies the contact forces
to them and to its own frame. It has no mass and is always in equilibrium.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.design import SensorDesign
from mjtactile.core.effect_names import Effect
from mjtactile.core.flags import Reasons
from mjtactile.core.types import Array
from mjtactile.kernels import bound, words
from mjtactile.quasistatic import MembraneStatus
from mjtactile.quasistatic.incremental import IncrementalMembrane
from mjtactile.quasistatic.membrane import QuasistaticMembrane
from mjtactile.sim.sensor import feature_size, validity_checks
from mjtactile.sim.sensor.base_sensor import BaseSensor
from mjtactile.sim.sensor.gas import ChamberGas
from mjtactile.sim.sensor.mesh import MembraneMesh, onto_mesh
from mjtactile.sim.sensor.quasistatic_forces import HOLD, pushes_of
from mjtactile.sim.sensor.quasistatic_gas import PATCH, STATE, QuasistaticGas
from mjtactile.sim.sensor.quasistatic_geoms import (
    FEELER,
    ContactGeoms,
    bulge_stiffness,
    membrane_of,
    sticking_of,
)

_LATE = 2  # steps without a solution in a row that are not worth a flag
_NO_FLEX = -2
# indices in the kernel's input
_FRICTION = 0
_GAS = 2
_TIME = 6


class QuasistaticSensor(BaseSensor):
    """Run time of one sensor without a mesh. It has the properties of `TactileSensor`."""

    contact = "quasistatic"

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        design: SensorDesign,
        mesh: MembraneMesh,
        prefix: str,
        effects: frozenset[str],
    ):
        """Bind the sensor to model and data. `mesh` has the resolution of the membrane.

        Raises InputError for a scene that a quasi-static membrane does not support.
        """
        super().__init__(model, data, design, mesh, prefix, effects)
        self._model = model
        self.flex_id = _NO_FLEX
        self.vertex_geom_ids = np.array([model.geom(prefix + FEELER).id])
        self.contact_ids = np.array([*self.vertex_geom_ids.repeat(2), self.flex_id])
        self._membrane = membrane = membrane_of(design, (mesh.nx, mesh.ny))
        self._onto_mesh = onto_mesh(membrane, mesh)
        top = float(membrane.rest.x[2].max())
        half = math.hypot(design.frame.length, design.frame.width) / 2
        extent = math.hypot(half, top) + 1e-3
        self._geoms = ContactGeoms(model, self.body_id, fixed_to_world=True)
        self._live = IncrementalMembrane(
            membrane, self._geoms.rows, self._geoms.pool, below_rim=math.inf
        )
        self._sticking = sticking_of(membrane)
        friction = design.membrane.friction if Effect.FRICTION in effects else 0.0
        self._given = _report(design, membrane, friction, model.opt.timestep, extent)
        self._numbers = np.zeros(STATE.itemsize // 8)
        self._state = self._numbers.view(STATE)[0]
        count = len(self._geoms.bodies)
        self._patch_numbers = np.zeros((count, PATCH.itemsize // 8))
        self._patches = self._patch_numbers.view(PATCH)[:, 0]
        self._grip = np.zeros((3 * count, 3 * count))
        # patches of the nodes, plus one: at the last sticking stiffness, and at the last solution
        self._touched = np.zeros((3, *membrane.grid), np.int32)
        self._before = np.zeros((10 + 6 * count, *membrane.grid))
        self._pushes = pushes_of(model, data)
        self._number = self._pushes.join(prefix, count)
        self._force = np.zeros((2, model.nv))  # and damping
        self._holds = np.zeros((count, HOLD))
        # largest extrapolated force so far, N, and the flag with it
        self._extrapolated = (0.0, "")
        # 1 if the membrane exerted a force at the last update
        self._pushing = np.zeros(1, np.int64)
        self._bind()
        stiffness = self._given[_GAS : _GAS + 1]
        self._qs_gas = QuasistaticGas(
            self._gas, self._live, self._state, stiffness, self._timestep, self.time
        )
        self._update_membrane()

    def _bind(self) -> None:
        """Bind the kernels to the arrays of model and data."""
        model, data, geoms = self._model, self._data, self._geoms
        bodies = (model.nbody, data.xpos, data.xmat)
        contact_geoms = (data.geom_xpos, data.geom_xmat, geoms.ids, geoms.slots, geoms.bounds)
        slots = (len(geoms.bodies), geoms.bodies)
        patches = (len(geoms.bodies), self._patch_numbers, geoms.bodies, self._grip)
        self._follow = bound(
            "qs_follow",
            *(*self._live.arguments, self._given, self._sticking.compliance),
            *(self.body_id, *bodies, model.ngeom, *contact_geoms),
            *(*slots, self._numbers, self._patch_numbers, self._grip, self._touched, self._before),
        )
        tree = (model.nbody, model.body_parentid, model.body_jntnum, model.body_jntadr)
        joints = (model.njnt, model.jnt_type, model.jnt_dofadr, data.xanchor, data.xaxis)
        self._find_push = bound(
            "qs_push",
            *(self._given, *patches, self.body_id, *tree, *joints, *bodies[1:]),
            *(model.nv, self._force, self._holds),
        )

    @property
    def friction(self) -> float:
        return float(self._given[_FRICTION])

    def set_friction(self, friction: float) -> None:
        self._given[_FRICTION] = friction

    # -- before every step

    def update(self) -> None:
        """Solve for equilibrium at the present poses and apply the forces, before every
        `mj_step`."""
        self._update_membrane()
        pushes = self._find_push()
        if pushes or self._pushing[0]:
            self._pushes.set(self._number, self._force, self._holds)
        self._pushing[0] = pushes

    def _update_to_now(self) -> None:
        self._update_membrane()
        self._qs_gas.advance(self.time)
        self.wake()

    def wake(self) -> None:
        """Evaluate the gas again after a change of valve or leak."""
        self._qs_gas.wake()

    def _update_membrane(self) -> None:
        """Update membrane, gas and sticking contact to the present poses, once per time instant."""
        data = self._data
        mujoco.mj_kinematics(self._model, data)
        self._given[_TIME] = data.time
        self._qs_gas.update_membrane(self.time)
        self._follow()

    # -- the chamber

    def _gas_now(self) -> ChamberGas:
        return self._qs_gas.at(self.time)

    @property
    def gauge_pressure(self) -> float:
        """Gauge pressure in the chamber, Pa, at the last update."""
        return self._qs_gas.gauge_pressure(self.time)

    @property
    def volume(self) -> float:
        """Gas volume, m^3, at the last update."""
        return self._qs_gas.volume

    @property
    def gas_time(self) -> float:
        return self.time

    def close_valve(self) -> None:
        """Close the valve and seal the current gas."""
        super().close_valve()
        self._qs_gas.close()

    def inflate(self, displacements: Array, gauge_pressure: float) -> None:
        """Set the membrane to `displacements` (3 k,), m, at rest, sealed at `gauge_pressure`,
        Pa."""
        live = self._live
        live.lie_flat()
        live.x.reshape(3, -1)[:, self.mesh.interior] = displacements.reshape(-1, 3).T
        live.rest_on(gauge_pressure, False, 1.0)
        self._numbers[:] = 0.0
        self._patch_numbers[:] = 0.0
        self._before[:] = 0.0
        self._qs_gas.seal(gauge_pressure, self.time)
        self._update_membrane()

    # -- for a kernel that continues by itself (`QuasistaticStepper`)

    def hold_gas(self) -> bool:
        """Treat the gas as sealed for some steps; False while the valve is open."""
        return self._qs_gas.hold(self.time)

    def follow_message(self) -> Array:
        """Return the arguments (38,) of `qs_follow` and the address of its flag."""
        return np.append(words(self._follow), self._pushing.ctypes.data)

    def push_message(self) -> Array:
        """Return the arguments (22,) of `qs_push` and the addresses of its two results."""
        return np.concatenate([words(self._find_push), self._pushes.addresses(self._number)])

    def add_messages(self) -> Array:
        """Return the arguments (13,) of `qs_add`."""
        return self._pushes.words()

    # -- present state

    @property
    def is_asleep(self) -> bool:
        """True if no obstacle is near, so that no computation is needed."""
        return not self.is_touched and not self._state["near"]

    @property
    def is_touched(self) -> bool:
        """True if an obstacle touches the membrane."""
        return bool(self._state["touching"] > 0)

    @property
    def wrench(self) -> Array:
        """Wrench (6,) on the membrane at the last update, N and N m about the origin of S."""
        return self._state["wrench"].copy()

    @property
    def contact_area(self) -> float:
        """Contact area, m^2."""
        return self._live.area if self.is_touched else 0.0

    @property
    def depth(self) -> float:
        """Maximum indentation of the membrane below its untouched shape, m."""
        return float((self._membrane.rest.x[2] - self._live.x[2]).max()) if self.is_touched else 0.0

    @property
    def slid(self) -> float:
        """Sliding distance of the obstacle over the membrane since first touch, m."""
        return float(self._state["slid"])

    @property
    def slides(self) -> bool:
        """True if the contact is at the friction limit."""
        return bool(self._state["slides"])

    def present_wrench(self) -> Array:
        """Return the wrench at the present time, equal to `wrench` after the next `update`."""
        self._update_membrane()
        return self.wrench

    @property
    def middle(self) -> Array:
        """Center of pressure (3,), m, frame S."""
        return self._state["middle"].copy()

    @property
    def radius(self) -> float:
        """Mean distance of the contact pressure from `middle`, m; 0 without contact."""
        return float(self._state["radius"])

    def contact_forces(self) -> tuple[Array, Array]:
        """Return forces (n, 3) N on the touching nodes and positions (n, 3) m, in S.

        The shear force of each body is distributed in proportion to the normal force.
        """
        force = self._live.force
        membrane = self._membrane
        x = self._live.x
        owners = self._touched[1]
        i, j = np.nonzero(owners)
        positions = np.stack(
            [membrane.x[i] + x[0, i, j], membrane.y[j] + x[1, i, j], x[2, i, j]], axis=1
        )
        normal = force[i, j]
        slots = owners[i, j] - 1
        totals = np.bincount(slots, normal, minlength=len(self._patches))
        fraction = normal / totals[slots]
        shear = self._patches["wrench"][slots, :2]
        return np.column_stack([fraction * shear[:, 0], fraction * shear[:, 1], -normal]), positions

    @property
    def p_SV(self) -> Array:
        """Present positions (n, 3) m in S of the mesh's vertices."""
        self._update_membrane()
        return self._positions()()

    def positions_now(self) -> Callable[[], Array]:
        """Return a function that computes `p_SV` of the present time later, if needed."""
        self._update_membrane()
        return self._positions()

    def _positions(self) -> Callable[[], Array]:
        """Return a function that computes `p_SV` of the last update."""
        x = self._live.x.copy()
        load = with_shear = None
        if self.is_touched and self.friction > 0:
            load = self._before[6:8].copy()
            with_shear = self._live.with_shear(self._state["wrench"][:2].copy())

        def positions() -> Array:
            # a membrane that shear moves also slides along inclined obstacles
            found = with_shear() if with_shear else None
            moved = (x if found is None else found[0]).reshape(3, -1).T.copy()
            if load is not None:
                remaining = load if found is None else load - found[1]
                inner = remaining[:, 1:-1, 1:-1].reshape(2, -1).T.ravel()
                moved[self.mesh.interior, :2] += (self._sticking.compliance @ inner).reshape(-1, 2)
            return self.mesh.p_SV + (moved if self._onto_mesh is None else self._onto_mesh @ moved)

        return positions

    @property
    def heights(self) -> Array:
        """Heights (k,) m of the inner nodes."""
        return self._live.x[2].ravel()[self.mesh.interior]

    @property
    def displacements(self) -> Array:
        """Displacements (3 k,) m of the inner nodes from the flat membrane; a copy."""
        return np.ascontiguousarray(self._live.x.reshape(3, -1).T[self.mesh.interior]).ravel()

    def penetrations(self, rows: NDArray[np.int64]) -> Array:
        """Return zeros: a quasi-static membrane lies on the obstacle without penetration."""
        return np.zeros(len(rows))

    @property
    def dofs(self) -> NDArray[np.int64]:
        """Empty array: a quasi-static membrane has no degrees of freedom in the model."""
        return np.empty(0, np.int64)

    def marker_poses_before(self, seconds: float) -> tuple[Array, Array]:
        """Return the present marker poses: a membrane in equilibrium has no motion blur."""
        return self.marker_poses()

    # -- its limits

    def flags(self) -> Reasons:
        """Return flags for reduced accuracy of the present state."""
        return self.contact_flags() | validity_checks.membrane_flags(
            self.design, self.gauge_pressure, *self.stretches()
        )

    def contact_flags(self) -> Reasons:
        """Return the flags of the present contact."""
        if not self._state["near"]:
            return {}
        narrow = self._live.relative_force_error() if self.is_touched else 0.0
        below, row = self._live.below_rim() if self.is_touched else (0.0, -1)
        return self.unsolved_flags() | validity_checks.quasistatic_flags(
            below, self._name(row), narrow
        )

    def unsolved_flags(self) -> Reasons:
        """Return the flag of a force that is extrapolated because there is no equilibrium."""
        lost = int(self._state["lost"])
        if lost <= _LATE and not self._state["lift"] > 0:
            return {}
        uncertain = float(self._state["uncertain"])
        if uncertain >= self._extrapolated[0]:
            status = MembraneStatus(int(self._state["status"]))
            reason = _REASONS.get(status, "the gas pressure jumps")
            force = (
                f"{uncertain:.2g} N of the force are extrapolated"
                if self.is_touched
                else "no force"
            )
            text = (
                f"sensor {self.prefix!r}: {self._name(self._live.deepest())} {reason} ({force}); "
                "switch 'mesh' on"
            )
            self._extrapolated = uncertain, text
        return {"quasistatic": self._extrapolated[1]}

    def failure(self) -> str | None:
        """Return the reason why this sensor's state is outside the membrane model, or None."""
        return self._empty()

    def _name(self, row: int) -> str:
        """Return the name of the geom of an obstacle."""
        if row < 0:
            return "an object"
        return repr(feature_size.name_of(self._model, int(self._geoms.ids[row])))


def _report(
    design: SensorDesign,
    membrane: QuasistaticMembrane,
    friction: float,
    timestep: float,
    extent: float,
) -> Array:
    """Return the constants of the kernels, as `PredictionReport` of kernels/qs_friction.h."""
    return np.array(
        [
            friction,
            bulge_stiffness(membrane),
            0.0,
            timestep,
            math.sqrt(design.frame.area / math.pi),
            min(membrane.x[1] - membrane.x[0], membrane.y[1] - membrane.y[0]),
            math.nan,
            extent,
        ]
    )


_REASONS = {
    MembraneStatus.NOT_CONVERGED: "leaves the quasi-static membrane without an equilibrium",
    MembraneStatus.GLASS_CONTACT: "presses the quasi-static membrane against the glass",
    MembraneStatus.INVERTED: "is too steep for the quasi-static membrane",
    MembraneStatus.NUMERICAL_FAILURE: "gives the quasi-static membrane no finite solution",
    MembraneStatus.TUNNELLING: "is so thin that it passes between the membrane's nodes",
    MembraneStatus.OVERSTRETCHED: "stretches the membrane beyond the range of its material model",
}
