"""Membrane fit: simulated holds, fitted to the markers.

The method is Gauss-Newton. The chamber is held at the pressure measured in each hold, so that the
gas has no effect. The unknowns are the modulus, the pre-stretch and the friction of the membrane.
Each recording adds the offset of the first contact from its mark.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.fit.gauss_newton import Scale, Solution, gauss_newton
from mjtactile.fit.measurements import Evidence, Hold
from mjtactile.fit.simulated_holds import Simulated, finer_mesh, simulate
from mjtactile.sim.attach import default_mesh

# systematic marker error in addition to noise, m; similar in all holds, so that averaging does not
# reduce it
MARKER_FLOOR = 8e-6
# limit of the indentation speed, m/s, and marker error above it, m: the state after a fast
# indentation depends on the path, which a simulated hold does not reproduce
FAST = 0.02
FAST_FLOOR = 5e-5
SHIFT_SD = 4e-6  # common height error in a hold, m
LOAD_CELL_SD = 0.01  # load cell error, N
DISCRETIZATION = "discretization error"
PRIOR = 1.0  # 1/sd of the scaled parameters without measurements: a factor of e, 0.2 of stretch
# significant error of all heights, thus of the lens: in sd, and its minimum as a fraction
_LENS_SURE = 3.0
LENS_MIN = 0.005
Notify = Callable[[str], None]


SCALES = {
    "young": Scale(1e4, 1e9),
    "pre_stretch": Scale(0.96, 1.9, 0.2),
    "friction": Scale(0.02, 5.0),
}
"""Fitted parameters of `Membrane`. Thickness and modulus enter as their product: see
`mjtactile.fit.parameter_info`."""


@dataclass(frozen=True)
class FitOptions:
    """Options of a fit.

    Attributes:
        finger: Name of the finger of the recordings.
        touch_sd: Standard deviation of a manually determined first contact, m.
        mesh: Vertices of the simulated membrane along x and y; None: the default.
        name: Name of the fitted sensor.
        notify: Function that receives the progress.
    """

    finger: str = "left"
    touch_sd: float = 5e-5
    mesh: tuple[int, int] | None = None
    name: str = "fitted"
    notify: Notify = lambda _: None


DEFAULT = FitOptions()


@dataclass(frozen=True, eq=False)
class MembraneFit:
    """Result of the membrane fit.

    `values` by name of SCALES; `cov` in SI by `names`, including the first contact of each loaded
    recording and the discretization error. `design` contains the values. `holds` are the simulated
    rest states and holds, a tuple per recording. `rms` is the marker residual, m, and `offsets` are
    those of the first contact by recording, m. `misfit` is the rms of the residuals in sd: above 1,
    it scales the covariance.

    `heights` is the common relative error of all measured heights, and its sd. `discretization` is
    the estimated discretization error: 0 for the mesh of the fit, 1 for an infinitely fine one.
    """

    values: Mapping[str, float]
    cov: Array
    names: tuple[str, ...]
    design: SensorDesign
    holds: tuple[tuple[Simulated, ...], ...]
    rms: float
    offsets: tuple[float, ...]
    misfit: float = 1.0
    heights: tuple[float, float] = (0.0, 0.0)
    discretization: float = 0.0

    @property
    def focal_scale(self) -> float:
        """Focal length relative to the sensor file; 1: no significant difference."""
        error, sd = self.heights
        is_sure = abs(error) > max(_LENS_SURE * sd, LENS_MIN)
        return 1 / (1 + error) if is_sure else 1.0


def fit_membrane(
    design: SensorDesign,
    evidence: Sequence[Evidence],
    *,
    known: Mapping[str, float],
    options: FitOptions = DEFAULT,
    start: Mapping[str, float] | None = None,
) -> MembraneFit:
    """Fit the parameters in SCALES that are not `known` (values by name), and the first contact of
    each loaded recording.

    Friction is fitted only if a recording contains shear. `start` contains values near the
    solution; None: those of `design`.
    """
    dragged = any(move.shear for e in evidence if e.stage for move in e.stage.moves)
    names = tuple(name for name in SCALES if name not in known and (name != "friction" or dragged))
    nominal = replace(design, membrane=replace(design.membrane, **known))
    return _Problem(nominal, evidence, names, options).solve(start or {})


class _Problem:
    """Least-squares problem of the membrane fit.

    The unknowns x are one value per parameter (see `Scale`), and the first contact of each loaded
    recording. Common marker errors are also unknown. These are a relative error of all heights, a
    shift of all heights in each hold, and the discretization error. First contacts and common
    errors are in sd.

    A recording that does not depend on a parameter is not simulated again for its column.
    """

    def __init__(
        self,
        design: SensorDesign,
        evidence: Sequence[Evidence],
        names: tuple[str, ...],
        options: FitOptions,
    ):
        self.design = design
        self.evidence = evidence
        self.names = names
        self.pressed = [i for i, measured in enumerate(evidence) if _is_loaded(measured)]
        self.options = options
        # a marker has the same error in all holds: each counts by its fraction of their number
        self._repeats = sum(1 + len(e.holds) for e in evidence)
        self._whiten = [[_whitener(hold, self._repeats) for hold in e.states] for e in evidence]
        self._lens_sd = max(e.height_fraction for e in evidence)
        self._common = self._common_modes()
        self._counts = len(names), len(self.pressed), self._common.shape[1]
        self._last: tuple[Array, list[tuple[Simulated, ...]]] = np.empty(0), []

    def solve(self, start: Mapping[str, float]) -> MembraneFit:
        nominal = [getattr(self.design.membrane, name) for name in self.names]
        scales = [SCALES[name] for name in self.names]
        ends = [
            (s.scaled(s.low, v), s.scaled(s.high, v)) for s, v in zip(scales, nominal, strict=True)
        ]
        count = self._counts[1] + self._counts[2] + 1
        low, high = np.array([*ends, *[(-np.inf, np.inf)] * count]).T
        first = np.zeros(len(low) - 1)
        for i, (name, scale, value) in enumerate(zip(self.names, scales, nominal, strict=True)):
            first[i] = scale.scaled(start.get(name, value), value)
        found = gauss_newton(self.residuals, self.jacobian, first, low=low[:-1], high=high[:-1])
        effect = self._discretization(found.x)
        self._common = np.column_stack([self._common, -effect])
        self._counts = (*self._counts[:2], self._counts[2] + 1)
        column = np.concatenate([effect, np.zeros(len(found.jacobian) - len(effect))])
        near = np.vstack([np.column_stack([found.jacobian, column]), np.eye(len(low))[-1]])
        found = gauss_newton(
            self.residuals, self.jacobian, np.append(found.x, 0.0), low=low, high=high, start=near
        )
        return self._result(found)

    def _discretization(self, x: Array) -> Array:
        """Return the change of the residuals with an infinitely fine mesh, (r,)."""
        design = self.design_at(x)
        finer, factor = finer_mesh(self.options.mesh or default_mesh(design))
        changes = [
            self._residuals(i, simulate(design, e, self.offset(i, x), finer))
            - self._residuals(i, holds)
            for i, (e, holds) in enumerate(zip(self.evidence, self._all(x), strict=True))
        ]
        return factor * np.concatenate(changes)

    def value(self, name: str, x: Array) -> float:
        nominal = getattr(self.design.membrane, name)
        return SCALES[name].value(float(x[self.names.index(name)]), nominal)

    def design_at(self, x: Array) -> SensorDesign:
        values = {name: self.value(name, x) for name in self.names}
        return replace(self.design, membrane=replace(self.design.membrane, **values))

    def offset(self, index: int, x: Array) -> float:
        """Return the depth of a recording's first touch below its mark, m."""
        if index in self.pressed:
            return self.options.touch_sd * float(x[len(self.names) + self.pressed.index(index)])
        return 0.0

    def simulate(self, index: int, x: Array) -> tuple[Simulated, ...]:
        return simulate(
            self.design_at(x), self.evidence[index], self.offset(index, x), self.options.mesh
        )

    def residuals(self, x: Array) -> Array:
        n = self._counts[0]
        found = [self._residuals(i, holds) for i, holds in enumerate(self._all(x))]
        left = np.concatenate(found) - self._common @ x[n + self._counts[1] :]
        self.options.notify(
            f"membrane: {', '.join(f'{n} {self.value(n, x):.4g}' for n in self.names)}; "
            f"{np.sqrt(self._repeats * np.mean(left**2)):.2f} sd (rms)"
        )
        return np.concatenate([left, PRIOR * x[:n], x[n:]])

    def jacobian(self, x: Array, _: Array) -> Array:
        base = [self._residuals(i, holds) for i, holds in enumerate(self._all(x))]
        columns = []
        n, m, k = self._counts
        for column in range(n + m):
            step = SCALES[self.names[column]].step if column < n else 0.5
            moved = x.copy()
            moved[column] += step
            parts = [np.zeros_like(part) for part in base]
            for i in range(len(self.evidence)):
                if self._depends(column, i):
                    parts[i] = (self._residuals(i, self.simulate(i, moved)) - base[i]) / step
            columns.append(np.concatenate(parts))
        return np.vstack(
            [np.column_stack([*columns, -self._common]), np.diag([PRIOR] * n + [1.0] * (m + k))]
        )

    def _all(self, x: Array) -> list[tuple[Simulated, ...]]:
        n = self._counts[0] + self._counts[1]
        if not np.array_equal(self._last[0], x[:n]):
            self._last = x[:n].copy(), [self.simulate(i, x) for i in range(len(self.evidence))]
        return self._last[1]

    def _residuals(self, index: int, holds: Sequence[Simulated]) -> Array:
        """Return simulated minus measured markers of a recording, whitened, and load cell
        forces."""
        e = self.evidence[index]
        parts = []
        triples = zip(e.states, holds, self._whiten[index], strict=True)
        for hold, simulated, (rows, weights) in triples:
            residual = simulated.p_SM[rows] - hold.p_SM[rows]
            parts.append(np.einsum("nij,nj->ni", weights, residual).ravel())
            if hold.is_weighed:
                parts.append(np.array([(-simulated.force[2] - hold.force) / LOAD_CELL_SD]))
        return np.concatenate(parts)

    def _common_modes(self) -> Array:
        """Return the change of the residuals for one sd of each common marker error, (r, 1 +
        holds)."""
        holds = [
            (hold, w)
            for e, ws in zip(self.evidence, self._whiten, strict=True)
            for hold, w in zip(e.states, ws, strict=True)
        ]
        blocks = []
        for index, (hold, (rows, weights)) in enumerate(holds):
            up = weights[:, :, 2]
            block = np.zeros((3 * len(rows) + hold.is_weighed, 1 + len(holds)))
            block[: 3 * len(rows), 0] = (self._lens_sd * hold.p_SM[rows, 2, None] * up).ravel()
            block[: 3 * len(rows), 1 + index] = (SHIFT_SD * up).ravel()
            blocks.append(block)
        return -np.concatenate(blocks)

    def _rms(self, holds: Sequence[Sequence[Simulated]]) -> float:
        residuals = [
            simulated.p_SM - hold.p_SM
            for e, found in zip(self.evidence, holds, strict=True)
            for hold, simulated in zip(e.states, found, strict=True)
        ]
        return float(np.sqrt(np.nanmean(np.square(residuals))))

    def _depends(self, column: int, index: int) -> bool:
        if column >= len(self.names):
            return index == self.pressed[column - len(self.names)]
        return self.names[column] != "friction" or index in self.pressed

    def _result(self, found: Solution) -> MembraneFit:
        n, m, _ = self._counts
        values = {name: self.value(name, found.x) for name in self.names}
        slopes = [SCALES[name].slope(values[name]) for name in self.names] + [
            self.options.touch_sd
        ] * m
        misfit = self._misfit(found)
        inverse = max(misfit, 1.0) ** 2 * np.linalg.inv(found.information)
        rows = [*range(n + m), len(inverse) - 1]
        cov = inverse[np.ix_(rows, rows)] * np.outer([*slopes, 1.0], [*slopes, 1.0])
        lens = self._lens_sd * np.array([found.x[n + m], math.sqrt(inverse[n + m, n + m])])
        touches = [first_touch(self.evidence[i]) for i in self.pressed]
        names = (*self.names, *touches, DISCRETIZATION)
        return MembraneFit(
            values,
            cov,
            names,
            self.design_at(found.x),
            tuple(self._all(found.x)),
            self._rms(self._all(found.x)),
            tuple(self.offset(i, found.x) for i in range(len(self.evidence))),
            misfit,
            (float(lens[0]), float(lens[1])),
            float(found.x[-1]),
        )

    def _misfit(self, found: Solution) -> float:
        """Return the rms of the measurements' residuals, in sd."""
        data = found.residuals[: len(self._common)]
        unknowns = sum(self._counts) - self._common.shape[1]
        return math.sqrt(self._repeats * float(data @ data) / max(len(data) - unknowns, 1))


def first_touch(evidence: Evidence) -> str:
    """Return the name of a recording's first contact in the covariance."""
    return f"first touch of {evidence.name}"


def is_fast(hold: Hold) -> bool:
    """Return True if a hold follows an indentation faster than FAST."""
    return hold.move is not None and hold.move.touches and hold.move.speed > FAST


def _is_loaded(evidence: Evidence) -> bool:
    """Return True if a stage indented the membrane to known depths."""
    if not evidence.stage:
        return False
    return any(not math.isnan(move.depth) for move in evidence.stage.moves)


def _whitener(hold: Hold, repeats: int) -> tuple[Array, Array]:
    """Return the rows of the detected markers, and their whitening matrices (n, 3, 3).

    The error of a marker repeats in that many holds, which averaging does not reduce.
    """
    rows = np.flatnonzero(np.isfinite(hold.p_SM).all(axis=1))
    noise = hold.cov[rows] + (FAST_FLOOR if is_fast(hold) else MARKER_FLOOR) ** 2 * np.eye(3)
    return rows, np.linalg.inv(np.linalg.cholesky(repeats * noise))
