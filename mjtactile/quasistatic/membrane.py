"""`QuasistaticMembrane`: one sensor's sheet on a grid, over its gas, ready to be pressed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.kernels import bound, kernel
from mjtactile.quasistatic import argument_checks, stiffness
from mjtactile.quasistatic import obstacles as obstacle_rows
from mjtactile.quasistatic.batch import at_once, new_batch
from mjtactile.quasistatic.constitutive_law import law_numbers, tension_slope
from mjtactile.quasistatic.cut_cells import cut_by
from mjtactile.quasistatic.discretization_error import REFINED, doubt
from mjtactile.quasistatic.inflation import inflate
from mjtactile.quasistatic.obstacles import Obstacle
from mjtactile.quasistatic.sensitivities import (
    POSE_STEP,
    Shape,
    SolutionSensitivities,
    changed_bodies,
    derived,
    moved_rows,
)
from mjtactile.quasistatic.solution import (
    FOUND,
    ContactSetup,
    MembraneSolution,
    MembraneSolutionBatch,
    judged,
)
from mjtactile.quasistatic.stick_contact import StuckPatch, patches_of

TOLERANCE = 5e-7  # m, of what is left of the displacements
_MAX_STEPS = 40
_MIXED_AREA = 1.05
"""Area ratio at which the tension's slope is taken; steps depend on it, results do not."""


class QuasistaticMembrane:
    """A sensor's sheet as a film. Makes no state: `solve` takes one and gives one.

    `x` (nx,) and `y` (ny,) are the nodes' places on the mounted flat sheet, m, the frame's among
    them, `spacing` the wider of theirs; `rest` is where it rests without a touch. Nodes beyond an
    outline that is no rectangle do not move.
    """

    def __init__(
        self,
        design: SensorDesign | str,
        grid: tuple[int, int] = (21, 16),
        gauge_pressure: float | None = None,
        *,
        sealed: bool = True,
    ):
        """Inflate a film.

        Args:
            design: the sensor, of any outline.
            grid: nodes along x and y, those on the frame among them.
            gauge_pressure: of the gas at rest, Pa; None: the sensor file's supply.
            sealed: whether the gas stays in, p V^gamma constant, or a valve holds its pressure.

        Raises:
            InputError: a grid or a pressure that is none, or with which the sheet finds no rest.
        """
        self.design = design = load_sensor(design)
        self.grid = argument_checks.grid(grid)
        frame, chamber, sheet = design.frame, design.chamber, design.membrane
        self.gauge_pressure = argument_checks.pressure(
            chamber.supply_gauge if gauge_pressure is None else gauge_pressure
        )
        self.sealed = sealed
        self.x, self.y = (
            np.linspace(-side / 2, side / 2, count)
            for side, count in zip((frame.length, frame.width), self.grid, strict=True)
        )
        law, self._law = law_numbers(sheet)
        tensions = (tension_slope(sheet, _MIXED_AREA), sheet.young * sheet.thickness)
        gas = (design.chamber_volume_flat, chamber.ambient, chamber.polytropic_exponent)
        sides = (frame.length, frame.width)
        depths = (sheet.thickness / 2, chamber.depth)
        stretch = sheet.pre_stretch**2
        self.spacing = max(float(line[1] - line[0]) for line in (self.x, self.y))
        self._cut, opening = cut_by(frame, self.x, self.y)
        membrane_parameters = (*sides, *self.grid, stretch, *law, *tensions)
        self._numbers = np.array([*membrane_parameters, *gas, *depths, opening, 0.0])
        self._point_at_cut()
        self._room = np.empty(kernel("film_room")(self._numbers))
        self._kept = np.empty(kernel("film_kept")(self._numbers), np.float32)
        self._rest = np.zeros((3, *self.grid))
        self._rooms: list[Array] = []  # of a batch's threads
        self._derive_room = np.empty(0)  # made when it is first asked for
        self._finer: dict[float, QuasistaticMembrane] = {}  # those that were asked for
        self._bind()
        self.rest = inflate(self)
        self._rest[:] = self.rest.x
        absolute = self.gauge_pressure + chamber.ambient
        volume = design.chamber_volume_flat + self.rest.volume
        self._gas = (
            absolute * volume**chamber.polytropic_exponent if sealed else self.gauge_pressure
        )

    def _point_at_cut(self) -> None:
        """Where kernels find what the outline leaves of the grid; of a rectangle, all."""
        self._numbers[-1] = self._cut.ctypes.data if self._cut.size else 0.0

    def _bind(self) -> None:
        later = (1, 0, 1, *[...] * 9)
        self._solve_one = bound("film_solve", *self._fixed(self._room), *later)

    def __getstate__(self) -> dict[str, Any]:
        kept = {name: value for name, value in vars(self).items() if name != "_solve_one"}
        return {**kept, "_rooms": [], "_finer": {}, "_derive_room": np.empty(0)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._point_at_cut()
        self._bind()

    @staticmethod
    def obstacle(
        kind: str,
        sizes: ArrayLike = (),
        p_SO: ArrayLike = (0.0, 0.0, 0.0),
        R_SO: ArrayLike | None = None,
        *,
        data: ArrayLike | None = None,
    ) -> Obstacle:
        """Make a body with a pose; see `mjtactile.quasistatic.obstacles.obstacle`.

        Args:
            kind: One of KINDS, such as "sphere", "box", "cylinder".
            sizes: Half sizes, m (curvatures 1/m), as in MJCF.
            p_SO: (3,) m of its middle in S.
            R_SO: (3, 3) its rotation in S; None: none.
            data: Vertices, triangles or heights, m, of a kind that has them.

        Returns:
            The body.
        """
        return obstacle_rows.obstacle(kind, sizes, p_SO, R_SO, data=data)

    def solve(
        self, obstacles: Obstacle | Sequence[Obstacle] = (), state: MembraneSolution | None = None
    ) -> MembraneSolution:
        """Find where the film rests on obstacles.

        Args:
            obstacles: One body or several.
            state: Where to start, usually the state before; None: untouched.

        Returns:
            The state, with `converged` False where none was found.

        Raises:
            InputError: An obstacle touches the rim, lies on the glass, pulls the sheet inside out
                or too far, or goes through between nodes.
        """
        listed = obstacle_rows.listed(obstacles, "obstacles")
        rows, pool = obstacle_rows.pooled(listed, self.grid)
        if state is not None:
            argument_checks.require_state(state, self.rest.x.shape)
        start = self.rest if state is None or not state.converged else state
        x, force, found = start.x.copy(), start.force.copy(), np.empty(FOUND)
        trend = np.zeros((4, *self.grid)) if start.trend is None else start.trend.copy()
        settings = np.array([self._gas, self.sealed, TOLERANCE, _MAX_STEPS, 1.0, 0.0])
        self._run(settings, rows, pool, (x, force, trend, found))
        pressing = ContactSetup(listed, self.x, self.y, self.design.membrane.thickness / 2)
        return judged(MembraneSolution(x, force, found, trend, pressing))

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
        """Where the films of several environments rest.

        Args:
            obstacles: the bodies of each environment, as many in each.
            batch: where to start; None: untouched. What did not converge starts untouched.
            threads: among which environments are shared out; results are the same bits with any.
            again: whether what finds no rest from where it starts is tried from rest, which costs
                many times as much.
            into: a batch of as many that is not wanted any more, which may be `batch`, to be
                written over: new memory costs up to a fifth of a solution, and in threads more.
            max_steps: after which what has found no rest is given up.

        Returns:
            The states, one after the other. What cannot be has a status, and raises nothing.

        Raises:
            InputError: no environment, or another number of bodies in one, or of environments in
                `batch` or `into`, or an argument of another type.
        """
        listed = argument_checks.environments(obstacles)
        count = len(listed)
        every = obstacle_rows.listed([body for one in listed for body in one], "obstacles")
        rows, pool = obstacle_rows.pooled(every, self.grid)
        for field, given in (("batch", batch), ("into", into)):
            if given is not None:
                argument_checks.require_batch(field, given, (count, 3, *self.grid))
        made = new_batch(count, self.grid) if into is None or into.trend is None else into
        settings = np.tile(
            [self._gas, self.sealed, TOLERANCE, max_steps, bool(again), 0.0], (count, 1)
        )
        threads = argument_checks.threads_among(threads, count)
        self._rooms += [np.empty_like(self._room) for _ in range(len(self._rooms), threads)]

        start = (None,) * 4 if batch is None else (batch.x, batch.force, batch.trend, batch.found)
        pooled, taken = 0 if pool is None else pool.size, np.zeros(1, np.int64)
        given = (count, taken, settings, len(rows) // count, rows, pooled, pool, *start)
        fields = (made.x, made.force, made.trend, made.found)
        # checked once, before the others wake: each would hold Python's lock for a twentieth of all
        share = bound("film_share", *self._fixed(self._room)[:-1], ..., *given, *fields)
        at_once(threads, lambda k: share(self._rooms[k]))
        return made

    def doubt(self, obstacles: Obstacle | Sequence[Obstacle]) -> float:
        """Find how far the force on a state may be off because bodies are narrow for this grid.

        Args:
            obstacles: One body or several.

        Returns:
            Share of the force within which 9 of 10 presses are
            (`mjtactile.quasistatic.discretization_error`): 0.03 for what is round and eight
            spacings wide, up to 0.25, at a cone's tip 0.4, on nodes 2 mm apart. Shallow contacts of
            few nodes are in `MembraneSolution.doubt` as well.
        """
        return doubt(obstacle_rows.listed(obstacles, "obstacles"), self.spacing)

    def refined_for(
        self, obstacles: Obstacle | Sequence[Obstacle], within: float = 0.03
    ) -> QuasistaticMembrane:
        """Find a film of this sensor on a grid that is as fine as what presses it wants.

        A step costs 40 us on 21 x 16 nodes, 120 on 41 x 31, 340 on 61 x 46, 700 on 81 x 61; a
        film that is not there yet, up to 0.2 s.

        Args:
            obstacles: One body or several, as wide as those that will press it.
            within: Of `doubt`.

        Returns:
            This film, if it is fine enough; else the coarsest of 1.5, 2, 3 or 4 times as many
            nodes along each side that is, and where none is, the finest: ask its `doubt`. The
            same object each time. States are of their own film's grid.
        """
        listed = obstacle_rows.listed(obstacles, "obstacles")
        enough = (by for by in REFINED if doubt(listed, self.spacing / by) <= within)
        by = next(enough, REFINED[-1])
        if by == 1:
            return self
        if by not in self._finer:
            grid = (round(by * (self.grid[0] - 1)) + 1, round(by * (self.grid[1] - 1)) + 1)
            self._finer[by] = QuasistaticMembrane(
                self.design, grid, self.gauge_pressure, sealed=self.sealed
            )
        return self._finer[by]

    def derivatives(
        self,
        state: MembraneSolution,
        shape: Shape,
        numbers: ArrayLike,
        steps: ArrayLike | None = None,
    ) -> SolutionSensitivities:
        """Find how a state changes with the numbers of what presses the film.

        Args:
            state: At rest on `shape(numbers)`.
            shape: Makes a body, or several, of numbers (n,): of a place, sizes, angles, curvatures.
            numbers: (n,), where to.
            steps: (n,) by which `shape` is asked beside `numbers`, on the side that their signs
                say; None: 1e-8 of each number, or of one.

        Returns:
            The derivatives, by each number.

        Raises:
            InputError: A state that is none, rests on something else, or is about to lose its
                balance; numbers or steps that are not finite.
        """
        self._require_rest(state)
        listed, by = changed_bodies(shape, numbers, steps)
        rows, pool = obstacle_rows.pooled([body for one in listed for body in one], self.grid)
        given = rows.reshape(len(listed), -1, obstacle_rows.NUMBERS), pool
        return derived(self, state, *given, by)

    def derivatives_by_pose(self, state: MembraneSolution) -> SolutionSensitivities:
        """Find how a state changes as what presses the film moves, all of it as one body: its
        wrench by that is the contact's stiffness. Costs two thirds of `derivatives` by six numbers.

        Args:
            state: At rest, from `solve`.

        Returns:
            The derivatives by six numbers: m along x, y and z of S, and rad about these axes
            through the origin of S.

        Raises:
            InputError: As for `derivatives`, a state of a batch, which does not know its bodies, or
                bodies that are heights over nodes, which have no pose.
        """
        self._require_rest(state)
        pressing = state.pressed_by.bodies
        if not pressing and state.force.any():
            raise InputError("is of a batch, and does not know its bodies", field="state")
        if any(body.kind == "heights" for body in pressing):
            raise InputError("rests on heights, which have no pose", field="state")
        rows, pool = obstacle_rows.pooled(pressing, self.grid)
        return derived(self, state, moved_rows(rows), pool, np.full(6, POSE_STEP))

    def _require_rest(self, state: MembraneSolution) -> None:
        if not state.converged or state.x.shape != self.rest.x.shape:
            raise InputError("is not at rest, or not of this film", field="state")

    def patches(self, state: MembraneSolution) -> list[StuckPatch]:
        """Find how stiffly each patch of contact, if it sticks, is held in the plane.

        Args:
            state: At rest.

        Returns:
            A patch for every set of neighbouring nodes that touch, largest force first; what lies
            between two patches is free, and neither moves the other.

        Raises:
            InputError: A state that is not at rest, or not of this film.
        """
        self._require_rest(state)
        return patches_of(self.x, self.y, state, self.stiffness_factor(state))

    def stiffness_factor(self, state: MembraneSolution) -> Array:
        """Factor the sheet's stiffness where a state is, over a gas that stays at its pressure.

        Args:
            state: At rest.

        Returns:
            The Cholesky factor's lower band (width + 1, 3 inner nodes), as SciPy has it; x, y and
            height of a node in turn.
        """
        return stiffness.factor_of(self, state)

    def obstacle_heights(
        self, obstacles: Obstacle | Sequence[Obstacle], places: ArrayLike
    ) -> Array:
        """Find how high obstacles leave the sheet's middle.

        Args:
            obstacles: One body or several.
            places: (n, 2) m, in S.

        Returns:
            (n,) m; infinite where there is no body.
        """
        listed = obstacle_rows.listed(obstacles, "obstacles")
        rows, pool = obstacle_rows.pooled(listed, self.grid)
        where = np.asarray(places, dtype=float).reshape(-1, 2)
        heights = np.empty(len(where))
        pooled = 0 if pool is None else len(pool)
        kernel("film_heights")(
            self._numbers, len(rows), rows, pooled, pool, len(where), where, heights
        )
        return heights

    def _run(
        self, settings: Array, rows: Array, pool: Array | None, fields: tuple[Array, ...]
    ) -> None:
        """The kernel on one film's displacements, forces, trend and what is found."""
        pooled = 0 if pool is None else pool.size
        self._solve_one(settings, len(rows), rows, pooled, pool, *fields)

    def _fixed(self, room: Array) -> tuple[Any, ...]:
        kept = (self._kept.size, self._kept)
        law = (self._numbers, self._law, *self.grid)
        return (*law, *kept, self._rest, room.size, room)
