"""`QuasistaticMembrane`: membrane of one sensor on a grid, inflated and ready for contact."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.signature_checks import not_below, validated
from mjtactile.core.types import Array
from mjtactile.kernels import bound, kernel
from mjtactile.quasistatic import argument_checks
from mjtactile.quasistatic import obstacles as obstacle_rows
from mjtactile.quasistatic.batch import new_batch, run_in_threads
from mjtactile.quasistatic.constitutive_law import law_numbers, tension_slope
from mjtactile.quasistatic.cut_cells import cut_grid
from mjtactile.quasistatic.discretization_error import REFINED, relative_force_error
from mjtactile.quasistatic.inflation import inflate
from mjtactile.quasistatic.obstacles import Obstacle
from mjtactile.quasistatic.sensitivities import (
    POSE_STEP,
    Shape,
    SolutionSensitivities,
    changed_obstacles,
    moved_obstacles,
    sensitivities_of,
)
from mjtactile.quasistatic.solution import (
    FOUND,
    FRICTIONLESS,
    ContactSetup,
    MembraneSolution,
    MembraneSolutionBatch,
    require_admissible,
)
from mjtactile.quasistatic.stick_contact import StuckPatch, patches_of, stiffness_band

TOLERANCE = 5e-7  # tolerance of the displacements, m
_MAX_STEPS = 40
_MIXED_AREA = 1.05
"""Area ratio of the tension's slope; steps depend on it, results do not."""
_ROOF = -3  # index in the constants
# height that a membrane does not reach, over that of its rest or over the frame's shorter side
_ROOF_OF_REST = 3.0
_ROOF_OF_SIDE = 0.25


@validated()
class QuasistaticMembrane:
    """Quasi-static model of a sensor's membrane.

    The object holds no state: `solve` takes one and returns one. `x` (nx,) and `y` (ny,), m, are
    the node positions on the mounted flat membrane. They include those on the frame. `spacing` is
    the larger of the two spacings. `rest` is the equilibrium without contact. Obstacles higher than
    `roof` m are out of reach. Nodes outside a non-rectangular outline are fixed.
    """

    def __init__(
        self,
        design: SensorDesign | str,
        grid: tuple[int, int] = (21, 16),
        gauge_pressure: float | None = None,
        *,
        sealed: bool = True,
    ):
        """Create a membrane and inflate it.

        Args:
            design: The sensor, with any outline.
            grid: Number of nodes along x and y, including those on the frame.
            gauge_pressure: Gauge pressure of the gas without contact, Pa; None: the sensor file's
                supply pressure.
            sealed: True if the gas is sealed in (p V^gamma constant), False if a valve holds its
                pressure.

        Raises:
            InputError: An invalid grid or pressure, or no equilibrium was found.
        """
        self.design = design = load_sensor(design)
        self.grid = argument_checks.grid(grid)
        frame, chamber, rubber = design.frame, design.chamber, design.membrane
        self.gauge_pressure = argument_checks.pressure(
            chamber.supply_gauge if gauge_pressure is None else gauge_pressure
        )
        self.sealed = sealed
        self.x, self.y = (
            np.linspace(-side / 2, side / 2, count)
            for side, count in zip((frame.length, frame.width), self.grid, strict=True)
        )
        law, self._law = law_numbers(rubber)
        tensions = (tension_slope(rubber, _MIXED_AREA), rubber.young * rubber.thickness)
        gas = (design.chamber_volume_flat, chamber.ambient, chamber.polytropic_exponent)
        sides = (frame.length, frame.width)
        depths = (rubber.thickness / 2, chamber.depth, math.inf)
        stretch = rubber.pre_stretch**2
        self.spacing = max(float(line[1] - line[0]) for line in (self.x, self.y))
        self._cut, opening = cut_grid(frame, self.x, self.y)
        membrane_parameters = (*sides, *self.grid, stretch, *law, *tensions)
        self._constants = np.array([*membrane_parameters, *gas, *depths, opening, 0.0])
        self._point_at_cut()
        self._room = np.empty(kernel("qs_workspace_size")(self._constants))
        self._kept = np.empty(kernel("qs_factors_size")(self._constants), np.float32)
        self._rest = np.zeros((3, *self.grid))
        self._rooms: list[Array] = []  # work arrays of a batch's threads
        self._derive_room = np.empty(0)  # made when it is first asked for
        self._finer: dict[float, QuasistaticMembrane] = {}  # those that were asked for
        self._bind()
        self.rest = inflate(self)
        self.roof = max(_ROOF_OF_REST * float(self.rest.x[2].max()), _ROOF_OF_SIDE * min(sides))
        self._constants[_ROOF] = self.roof
        self._rest[:] = self.rest.x
        absolute = self.gauge_pressure + chamber.ambient
        volume = design.chamber_volume_flat + self.rest.volume
        self._gas = (
            absolute * volume**chamber.polytropic_exponent if sealed else self.gauge_pressure
        )

    def _point_at_cut(self) -> None:
        """Store the address of the cut cells for the kernels, or 0 for a rectangle."""
        self._constants[-1] = self._cut.ctypes.data if self._cut.size else 0.0

    def _bind(self) -> None:
        later = (1, 0, 1, *[...] * 9)
        self._solve_one = bound("qs_solve", *self._fixed(self._room), *later)

    def __getstate__(self) -> dict[str, Any]:
        kept = {name: value for name, value in vars(self).items() if name != "_solve_one"}
        return {**kept, "_rooms": [], "_finer": {}, "_derive_room": np.empty(0)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._point_at_cut()
        self._bind()

    @staticmethod
    @validated()
    def obstacle(
        kind: str,
        sizes: ArrayLike = (),
        p_SO: ArrayLike = (0.0, 0.0, 0.0),
        R_SO: ArrayLike | None = None,
        *,
        data: ArrayLike | None = None,
    ) -> Obstacle:
        """Create an obstacle with a pose; see `mjtactile.quasistatic.obstacles.obstacle`.

        Args:
            kind: One of KINDS, such as "sphere", "box", "cylinder".
            sizes: Half sizes, m (curvatures 1/m), as in MJCF.
            p_SO: Position of its center (3,), m, frame S.
            R_SO: Rotation (3, 3) in S; None: identity.
            data: Vertices, triangles or heights, m, for kinds that have them.

        Returns:
            The obstacle.
        """
        return obstacle_rows.obstacle(kind, sizes, p_SO, R_SO, data=data)

    def solve(
        self, obstacles: Obstacle | Sequence[Obstacle] = (), state: MembraneSolution | None = None
    ) -> MembraneSolution:
        """Find the equilibrium of the membrane on obstacles.

        Args:
            obstacles: One or several obstacles.
            state: Initial state, usually the previous solution; None: no contact.

        Returns:
            The state; `converged` is False if no equilibrium was found.

        Raises:
            InputError: An obstacle touches the rim, lies on the glass, inverts or overstretches the
                membrane, or passes between nodes.
        """
        listed = obstacle_rows.as_list(obstacles, "obstacles")
        rows, pool = obstacle_rows.rows_and_pool(listed, self.grid)
        if state is not None:
            argument_checks.require_state(state, self.rest.x.shape)
        start = self.rest if state is None or not state.converged else state
        x, force, found = start.x.copy(), start.force.copy(), np.empty(FOUND)
        trend = np.zeros((4, *self.grid)) if start.trend is None else start.trend.copy()
        settings = np.array(
            [self._gas, self.sealed, TOLERANCE, _MAX_STEPS, 1.0, 0.0, *FRICTIONLESS]
        )
        self._run(settings, rows, pool, (x, force, trend, found))
        pressing = ContactSetup(listed, self.x, self.y, self.design.membrane.thickness / 2)
        return require_admissible(MembraneSolution(x, force, found, trend, pressing))

    def solve_batch(
        self,
        obstacles: Sequence[Sequence[Obstacle]],
        batch: MembraneSolutionBatch | None = None,
        *,
        threads: int = 1,
        again: bool = True,
        into: MembraneSolutionBatch | None = None,
        max_steps: int = _MAX_STEPS,
    ) -> MembraneSolutionBatch:
        """Find the equilibria of the membranes of several environments.

        Args:
            obstacles: Obstacles of each environment, the same number in each.
            batch: Initial states; None: no contact. States that did not converge are replaced by
                the one without contact.
            threads: Number of threads; the results are bit-identical for any number.
            again: True to repeat a failed solution from the state without contact, at many times
                the cost.
            into: A batch of the same size to overwrite, which may be `batch`. New memory costs up
                to 20 % of a solution, and more with threads.
            max_steps: Maximum number of steps of a solution.

        Returns:
            The states in order. An invalid solution has a status and raises no error.

        Raises:
            InputError: No environments, a different number of obstacles in one environment, a
                different number of environments in `batch` or `into`, or an argument of the wrong
                type.
        """
        listed = argument_checks.environments(obstacles)
        count = len(listed)
        every = obstacle_rows.as_list(
            [body for environment in listed for body in environment], "obstacles"
        )
        rows, pool = obstacle_rows.rows_and_pool(every, self.grid)
        for field, given in (("batch", batch), ("into", into)):
            if given is not None:
                argument_checks.require_batch(field, given, (count, 3, *self.grid))
        made = new_batch(count, self.grid) if into is None or into.trend is None else into
        steps = argument_checks.step_count(max_steps)
        repeats = argument_checks.flag("again", again)
        each = [self._gas, self.sealed, TOLERANCE, steps, repeats, 0.0, *FRICTIONLESS]
        settings = np.tile(each, (count, 1))
        threads = argument_checks.thread_count(threads, count)
        self._rooms += [np.empty_like(self._room) for _ in range(len(self._rooms), threads)]

        start = (None,) * 4 if batch is None else (batch.x, batch.force, batch.trend, batch.found)
        pooled, taken = 0 if pool is None else pool.size, np.zeros(1, np.int64)
        given = (count, taken, settings, len(rows) // count, rows, pooled, pool, *start)
        fields = (made.x, made.force, made.trend, made.found)
        # checked once, before the others wake: each would hold Python's lock for a twentieth of all
        fraction = bound("qs_solve_batch", *self._fixed(self._room)[:-1], ..., *given, *fields)
        run_in_threads(threads, lambda k: fraction(self._rooms[k]))
        return made

    def resume(
        self,
        rows: Array,
        pool: Array | None,
        state: MembraneSolution,
        tolerance: float = TOLERANCE,
        max_steps: int = _MAX_STEPS,
        again: bool = False,
        shear: Array | None = None,
    ) -> MembraneSolution:
        """Find the equilibrium on other obstacles. Arguments are not checked.

        Args:
            rows: Rows (k, NUMBERS) of the obstacles (`quasistatic.obstacles`).
            pool: Their data; None: they have none.
            state: Converged initial state.
            tolerance: Tolerance of the displacements, m.
            max_steps: Maximum number of steps.
            again: As in `solve_batch`.
            shear: In-plane force of the contact (2,), N, which is distributed like the normal
                force; None: without friction.

        Returns:
            The state. An invalid solution has a status and raises no error.
        """
        found, trend = np.empty(FOUND), np.zeros((4, *self.grid))
        x, force = state.x.copy(), state.force.copy()
        friction = FRICTIONLESS if shear is None else (1.0, *shear)
        settings = np.array([self._gas, self.sealed, tolerance, max_steps, again, 0.0, *friction])
        self._run(settings, rows, pool, (x, force, trend, found))
        return MembraneSolution(x, force, found, trend)

    def relative_force_error(self, obstacles: Obstacle | Sequence[Obstacle]) -> float:
        """Return the force error due to obstacles that are narrow for this grid.

        Args:
            obstacles: One or several obstacles.

        Returns:
            Relative force error not exceeded in 9 of 10 cases
            (`mjtactile.quasistatic.discretization_error`). On nodes 2 mm apart it is 0.03 for round
            obstacles eight spacings wide, up to 0.25 for narrow ones, and 0.4 at a cone's tip.
            `MembraneSolution.relative_force_error` also includes shallow contacts of few nodes.
        """
        return relative_force_error(obstacle_rows.as_list(obstacles, "obstacles"), self.spacing)

    @validated(within=not_below(0))
    def refined_for(
        self, obstacles: Obstacle | Sequence[Obstacle], within: float = 0.03
    ) -> QuasistaticMembrane:
        """Return a membrane of this sensor on a grid that is fine enough for the obstacles.

        A step takes 40 us on 21 x 16 nodes, 120 on 41 x 31, 340 on 61 x 46, 700 on 81 x 61. The
        creation of a new membrane takes up to 0.2 s.

        Args:
            obstacles: One or several obstacles with the widths of later ones.
            within: Limit of `relative_force_error`.

        Returns:
            This membrane, if it is fine enough. Otherwise the coarsest sufficient grid with 1.5, 2,
            3 or 4 times as many nodes along each side. If none is sufficient, the finest: check its
            `relative_force_error`. The same object is returned each time. A state belongs to the
            grid of its own membrane.
        """
        listed = obstacle_rows.as_list(obstacles, "obstacles")
        enough = (by for by in REFINED if relative_force_error(listed, self.spacing / by) <= within)
        by = next(enough, REFINED[-1])
        if by == 1:
            return self
        if by not in self._finer:
            grid = (round(by * (self.grid[0] - 1)) + 1, round(by * (self.grid[1] - 1)) + 1)
            self._finer[by] = QuasistaticMembrane(
                self.design, grid, self.gauge_pressure, sealed=self.sealed
            )
        return self._finer[by]

    @validated()
    def derivatives(
        self,
        state: MembraneSolution,
        shape: Shape,
        parameters: ArrayLike,
        steps: ArrayLike | None = None,
    ) -> SolutionSensitivities:
        """Compute the derivatives of a state by the parameters of the obstacles.

        Args:
            state: Equilibrium on `shape(numbers)`.
            shape: Function that creates one or several obstacles from parameters (n,): positions,
                sizes, angles, curvatures.
            parameters: Parameters (n,) at which to differentiate.
            steps: Difference steps (n,) of the parameters, with the sign of the side; None: 1e-8 of
                each parameter, at least 1e-8.

        Returns:
            The derivatives by each parameter.

        Raises:
            InputError: An invalid state, one on other obstacles, or one close to instability;
                parameters or steps that are not finite.
        """
        self._require_rest(state)
        listed, by = changed_obstacles(shape, parameters, steps)
        every = [body for bodies in listed for body in bodies]
        rows, pool = obstacle_rows.rows_and_pool(every, self.grid)
        given = rows.reshape(len(listed), -1, obstacle_rows.NUMBERS), pool
        return sensitivities_of(self, state, *given, by)

    @validated()
    def derivatives_by_pose(self, state: MembraneSolution) -> SolutionSensitivities:
        """Compute the derivatives of a state by a common rigid motion of all obstacles.

        The derivative of the wrench is the contact stiffness. The cost is two thirds of that of
        `derivatives` with six parameters.

        Args:
            state: Equilibrium, from `solve`.

        Returns:
            The derivatives by six parameters: translation along x, y and z of S, m, and rotation
            about these axes through the origin of S, rad.

        Raises:
            InputError: As for `derivatives`; also for a state of a batch, which has no record of
                its obstacles, and for height fields, which have no pose.
        """
        self._require_rest(state)
        pressing = state.contact_setup.bodies
        if not pressing and state.force.any():
            raise InputError("belongs to a batch, which stores no obstacles", field="state")
        if any(body.kind == "heights" for body in pressing):
            raise InputError("is in contact with a height field, which has no pose", field="state")
        rows, pool = obstacle_rows.rows_and_pool(pressing, self.grid)
        return sensitivities_of(self, state, moved_obstacles(rows), pool, np.full(6, POSE_STEP))

    def _require_rest(self, state: MembraneSolution) -> None:
        if not state.converged or state.x.shape != self.rest.x.shape:
            raise InputError("is not an equilibrium of this membrane", field="state")

    @validated()
    def patches(self, state: MembraneSolution) -> list[StuckPatch]:
        """Compute the in-plane stiffness of each contact patch, if it sticks.

        Args:
            state: Equilibrium.

        Returns:
            A patch for every set of neighboring nodes in contact, largest force first. The membrane
            between patches is free, and the patches are independent.

        Raises:
            InputError: A state that is not an equilibrium, or belongs to another membrane.
        """
        self._require_rest(state)
        return patches_of(self.x, self.y, state, self.stiffness_factor(state))

    @validated()
    def stiffness_factor(self, state: MembraneSolution) -> Array:
        """Factorize the stiffness of the membrane in a state, with gas at constant pressure.

        Args:
            state: Equilibrium.

        Returns:
            The Cholesky factor's lower band (width + 1, 3 inner nodes) in SciPy's format. Each node
            has x, y and height in order.
        """
        width = 3 * self.grid[1] - 1
        return np.ascontiguousarray(stiffness_band(self, state)[:, : width + 1].T)

    def obstacle_heights(
        self, obstacles: Obstacle | Sequence[Obstacle], positions: ArrayLike
    ) -> Array:
        """Return the maximum height of the membrane's mid-surface below obstacles.

        Args:
            obstacles: One or several obstacles.
            positions: Points (n, 2), m, in S.

        Returns:
            (n,) Heights, m; infinite where there is no obstacle.

        Raises:
            InputError: An argument is not an obstacle or not a list of points.
        """
        listed = obstacle_rows.as_list(obstacles, "obstacles")
        rows, pool = obstacle_rows.rows_and_pool(listed, self.grid)
        where = argument_checks.points(positions)
        heights = np.empty(len(where))
        pooled = 0 if pool is None else len(pool)
        kernel("qs_obstacle_heights")(
            self._constants, len(rows), rows, pooled, pool, len(where), where, heights
        )
        return heights

    def _run(
        self, settings: Array, rows: Array, pool: Array | None, fields: tuple[Array, ...]
    ) -> None:
        """Run the kernel on the displacements, forces, trend and results of one membrane."""
        pooled = 0 if pool is None else pool.size
        self._solve_one(settings, len(rows), rows, pooled, pool, *fields)

    def _fixed(self, room: Array) -> tuple[Any, ...]:
        kept = (self._kept.size, self._kept)
        law = (self._constants, self._law, *self.grid)
        return (*law, *kept, self._rest, room.size, room)
