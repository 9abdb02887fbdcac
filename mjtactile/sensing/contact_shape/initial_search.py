"""Search for shapes without a prior.

A ball is lowered until the force matches. Other models start from the shapes fitted so far.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import SHAPES, Array
from mjtactile.quasistatic import MembraneSolution
from mjtactile.quasistatic.solution import AREA
from mjtactile.sensing.contact_shape.amortized_start import Proposal
from mjtactile.sensing.contact_shape.fit_state import Data, FitState, Prior, Problem
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.gauss_newton import Fit, refine
from mjtactile.sensing.contact_shape.primitives import InitialGuess, principal
from mjtactile.sensing.contact_shape.random_presses import GROUPS
from mjtactile.sensing.contact_shape.shape_models import FAMILIES, ShapeModel

_APPROACH = (1.2, 0.7, 0.3, 0.0)  # heights above the start, mm: the membrane is indented in steps
_WIDE = (0.75, 1.05)  # radius of a start disc relative to a disc with the contact's area
_FORCE_STEPS = 3
_FORCE_NEAR = 0.1  # tolerance relative to the estimated force
_STIFFNESS = (0.05, 0.12, 2.0)  # contact stiffness, N/mm: minimum, first, maximum
_HOPELESS = 120.0  # excess of the sum of squares over the noise above which a family is not fitted
_ENOUGH = 0.9  # probability of the suggested models together
_UNLIKELY = 8.0  # log probability behind the likeliest model where a model is not fitted
_SURE = 0.003  # probability that a network does not exclude
_ROUNDS = 8  # membrane solutions of a fit from a suggested start
_EXPLAINED = 1.0  # misfit below which no further start of several contacts is fitted
_FIRST_CURVATURE = 80.0  # 1/m
_ORDER = {"ball": 0, "smooth": 1, "cylinder": 2}  # others later


def search(
    forward: ForwardModel,
    families: Sequence[ShapeModel],
    hint: InitialGuess,
    data: Data,
    noise: float,
    near: MembraneSolution | None = None,
    known: float = math.inf,
) -> list[Fit]:
    """Fit each model without a prior from earlier images. Models that fit much worse than others or
    did not converge are left out. `near` is the membrane solution on another shape, from the
    previous image; a model that does not converge from there is not tried from farther away.
    `known` is the sum of squares of a model that is not among these. Marker variances are
    multiplied by `noise`."""
    found: list[Fit] = []
    for family in sorted(families, key=lambda model: _ORDER.get(model.name, len(_ORDER))):
        fit = _best_start(forward, family, hint, data, found, noise, near, known)
        if fit is not None:
            found.append(fit)
    if not found:
        return []
    found = _reuse_curvature(forward, hint, data, found, noise)
    minimum = min(fit.chi2 for fit in found)
    noise = max(noise, minimum / len(data.heights))
    return [fit for fit in found if fit.chi2 <= minimum + _HOPELESS * noise]


@dataclass(frozen=True, eq=False)
class Suggestions:
    """Start parameters of shape models for one image. They are relative to `reference`."""

    proposal: Proposal
    reference: InitialGuess

    @property
    def several(self) -> float:
        """Probability of several contacts."""
        return float(self.proposal.kinds[SHAPES.index("multiple")])

    def names(self, count: int) -> list[str]:
        """Return the names of the likeliest shape models, at most `count`; one if several contacts
        are far more likely than all."""
        probabilities = self.proposal.probabilities[: len(FAMILIES)]
        total = float(probabilities.sum())
        order = np.argsort(-probabilities, kind="stable")
        fraction = np.cumsum(probabilities[order]) / max(total, 1e-300)
        enough = int(np.searchsorted(fraction, _ENOUGH)) + 1
        if total < _SURE * self.probability("multiple"):
            enough = 1
        return [GROUPS[index] for index in order[: min(count, enough)]]

    def likely(self, logs: Mapping[str, float]) -> dict[str, float]:
        """Return the log evidence of the likely models. It is that of earlier images, `logs`, plus
        the log probability by this image."""
        behind = {
            name: log + math.log(max(self.probability(name), _SURE)) for name, log in logs.items()
        }
        maximum = max(behind.values(), default=0.0)
        return {name: log for name, log in behind.items() if log > maximum - _UNLIKELY}

    def probability(self, name: str) -> float:
        """Return the probability of a shape model."""
        return float(self.proposal.probabilities[GROUPS.index(name)])

    def fit(
        self,
        forward: ForwardModel,
        family: ShapeModel,
        hint: InitialGuess,
        data: Data,
        noise: float,
        near: MembraneSolution | None = None,
        known: float = math.inf,
    ) -> Fit | None:
        """Fit a model from its start; None: the solver did not converge. `near`, `known` and
        `noise` are those of `search`."""
        theta = family.rebased(self.proposal.theta(family.name), self.reference, hint)
        problem = Problem(forward, family, hint, data, Prior.of(family, theta))
        at = replace_shape(problem, theta, near) or problem.fit_state(theta, None)
        if at is None:
            return None
        return refine(problem, at, rounds=_ROUNDS, known=known, noise=noise)


def suggested(
    forward: ForwardModel,
    suggestions: Suggestions,
    hint: InitialGuess,
    data: Data,
    noise: float,
    count: int,
) -> list[Fit]:
    """Fit the `count` likeliest models, each from its start."""
    found: list[Fit] = []
    for name in suggestions.names(count):
        best = min(found, key=lambda one: one.chi2, default=None)
        near, known = (None, math.inf) if best is None else (best.state, best.chi2)
        fit = suggestions.fit(forward, FAMILIES[name], hint, data, noise, near, known)
        if fit is not None:
            found.append(fit)
    return found


def _reuse_curvature(
    forward: ForwardModel, hint: InitialGuess, data: Data, found: list[Fit], noise: float
) -> list[Fit]:
    """Refit the smooth model from the lying cylinder if that special case of it fits better."""
    by_name = {fit.family.name: fit for fit in found}
    smooth, line = (by_name.get(name) for name in ("smooth", "cylinder"))
    if smooth is None or line is None or line.chi2 > smooth.chi2:
        return found
    maximum, direction = line.theta[3:5]
    across = np.array([math.sin(direction), -math.cos(direction)])
    bent = maximum * np.outer(across, across)
    theta = np.array([*line.theta[:3], bent[0, 0], bent[0, 1], bent[1, 1]])
    problem = Problem(forward, smooth.family, hint, data, smooth.prior)
    at = problem.fit_state(theta, line.state)
    if at is None or at.cost > smooth.at.cost:
        return found
    other = refine(problem, at, known=min(fit.chi2 for fit in found), noise=noise)
    return [other if fit is smooth else fit for fit in found]


def _best_start(
    forward: ForwardModel,
    family: ShapeModel,
    hint: InitialGuess,
    data: Data,
    known: Sequence[Fit],
    noise: float,
    near: MembraneSolution | None,
    minimum: float,
) -> Fit | None:
    """Fit a model from the start that explains the markers best after matching the force."""
    reached: list[tuple[Problem, FitState]] = []
    state = min(known, key=lambda one: one.chi2).state if known else near
    minimum = min([minimum, *(one.chi2 for one in known)])
    fits: list[Fit] = []
    for start in _starts(family, hint, known, _ContactRegion.of(forward, state)):
        problem = Problem(forward, family, hint, data, Prior.of(family, start))
        at = replace_shape(problem, start, state)
        if at is None and (near is None or family.parts):
            at = approach(problem, start)
        if at is not None:
            reached.append((problem, at))
        # with several parts, different starts may converge to different fits
        if at is not None and family.parts:
            fits.append(refine(problem, at, known=minimum, noise=noise))
            if fits[-1].misfit < _EXPLAINED:
                break
    if reached and not family.parts:
        problem, at = min(reached, key=lambda one: one[1].cost)
        return refine(problem, at, known=minimum, noise=noise)
    return min(fits, key=lambda fit: fit.at.cost, default=None)


def _starts(
    family: ShapeModel, hint: InitialGuess, known: Sequence[Fit], region: _ContactRegion | None
) -> Sequence[Array]:
    """Return start parameters of a model. Usually they are the model's own, moved to the contact of
    the other shape and scaled to its size. A model related to another (ball, smooth, cylinder)
    starts from that model's fit."""
    if family.parts:
        return family.starts(hint)
    by_name = {one.family.name: one.theta for one in known}
    if family.name == "ball":
        return (np.array([0.0, 0.0, 0.0, _FIRST_CURVATURE]),)
    if family.name == "smooth" and "ball" in by_name:
        theta = by_name["ball"]
        return (np.array([*theta[:4], 0.0, theta[3]]),)
    if family.name == "cylinder" and "smooth" in by_name:
        theta = by_name["smooth"]
        maximum, _, direction = principal(theta)
        return (np.array([*theta[:3], maximum, direction, 0.0]),)
    if region is None:
        return family.starts(hint)
    x, y = 1e3 * (region.center - hint.position)
    radius = 1e3 * math.sqrt(region.area / math.pi)
    if family.name == "disc":
        return tuple(np.array([x, y, 0, 0, 0, fraction * radius]) for fraction in _WIDE)
    if family.name == "block":
        half = math.sqrt(math.pi) / 2 * radius
        turned = hint.angle + math.pi / 4
        return (
            np.array([x, y, 0, 0, 0, region.angle, *1e3 * region.half_extents]),
            np.array([x, y, 0, 0, 0, turned, half, half]),
        )
    return tuple(np.array([x, y, *start[2:]]) for start in family.starts(hint))


@dataclass(frozen=True, eq=False)
class _ContactRegion:
    """Contact region of a membrane solution: `center` (2,), m, `area`, m^2, `angle` of the longer
    axis, rad, and `half_extents` (2,), m, of a rectangle with the same force spread."""

    center: Array
    area: float
    angle: float
    half_extents: Array

    @classmethod
    def of(cls, forward: ForwardModel, state: MembraneSolution | None) -> _ContactRegion | None:
        """Compute the contact region of a membrane solution; None without contact."""
        if state is None or not (state.force > 0).any():
            return None
        force, x, y = _contact_nodes(forward, state)
        fraction = force / force.sum()
        center = np.array([fraction @ x, fraction @ y])
        offset = np.array([x - center[0], y - center[1]])
        spread, axes = np.linalg.eigh((offset * fraction) @ offset.T)
        wide = np.sqrt(3 * np.maximum(spread[::-1], forward.spacing**2 / 3))
        return cls(center, float(state.found[AREA]), math.atan2(axes[1, 1], axes[0, 1]), wide)


def _contact_nodes(forward: ForwardModel, state: MembraneSolution) -> tuple[Array, Array, Array]:
    """Return force (n,), N, and positions x and y (n,), m, of the touching nodes."""
    touching = state.force > 0
    x, y = (
        nodes[touching] + moved[touching]
        for nodes, moved in zip(forward.nodes, state.x[:2], strict=True)
    )
    return state.force[touching], x, y


def replace_shape(
    problem: Problem, start: Array, state: MembraneSolution | None
) -> FitState | None:
    """Replace a shape, with membrane solution `state`, by another one at the same position. First
    choose its height so that the contact forces do no work on the change. Then adjust it to the
    force. Return the start state of a fit; None: the solver did not converge."""
    family = problem.family
    if state is None or family.parts or not (state.force > 0).any():
        return None
    force, x, y = _contact_nodes(problem.forward, state)
    theta = problem.clip(start)
    membrane = problem.forward.membrane
    heights = membrane.obstacle_heights(family.build(theta, problem.hint), np.column_stack([x, y]))
    there = np.isfinite(heights)
    if not there.any():
        return None
    gap = (force * (state.x[2][state.force > 0] - heights))[there].sum() / force[there].sum()
    theta[2] += 1e3 * gap
    theta = problem.clip(theta)
    solution = problem.solve(theta, state)
    return None if solution is None else _shift_to_force(problem, theta, solution)


def approach(problem: Problem, start: Array) -> FitState | None:
    """Lower a shape from about the height of first contact into the membrane until its force
    matches the estimated force. Return the start state of a fit; None: the solver did not
    converge."""
    theta = problem.clip(start)
    state = None
    reached = theta
    for above in _APPROACH:
        trial = theta.copy()
        trial[problem.family.heights] += above
        solution = problem.solve(trial, state)
        if solution is None:
            break
        state = solution
        reached = trial
        if state.force_normal > problem.data.force:
            break
    return None if state is None else _shift_to_force(problem, reached, state)


def _shift_to_force(problem: Problem, theta: Array, state: MembraneSolution) -> FitState:
    """Move a shape up or down until its force is close to the estimated force."""
    heights = problem.family.heights
    stiffness = _STIFFNESS[1] * len(heights)
    goal = problem.data.force
    for _ in range(_FORCE_STEPS):
        force = state.force_normal
        if abs(force - goal) < _FORCE_NEAR * goal:
            break
        down = float(np.clip((goal - force) / stiffness, -0.5, 0.5))
        trial = theta.copy()
        trial[heights] -= down
        trial = problem.clip(trial)
        solution = problem.solve(trial, state)
        if solution is None:
            break
        theta = trial
        state = solution
        if abs(down) > 1e-6:
            change = (state.force_normal - force) / down
            stiffness = float(np.clip(change, _STIFFNESS[0], _STIFFNESS[2]))
    return problem.state(theta, state)
