"""Slip detection from the motion of the contact over the rubber.

The motion is relative to the rubber's own motion. Markers are material points. So the center of
pressure is known in the membrane's *material* coordinates. While the object sticks, the center
stays there, however far the membrane is dragged. If the object slips, the center moves along the
shear force. The rubber under it no longer follows. This needs no coefficient of friction. Two other
causes of motion are accounted for. Partial slip is proportional to the drag distance of the rubber.
Tilting of the object is proportional to two factors. They are the change of shear over normal
force, and the contact's length squared. The remainder is tested for a ramp that started a few
images ago, by its matched filter (Eq. F14). A patch that moves without shear rolls.

The shear distribution inside the contact carries more information. On flat faces the center of
pressure does not move, and it is the only evidence. Under full sliding each part of the contact is
dragged by friction alone. So shear over pressure is uniform (Coulomb), independent of the friction
coefficient. While the center sticks, the ratio is lower there (Cattaneo, Mindlin). Uniform shear is
slip. Nonuniform shear is evidence against slip. Then stronger evidence of the other kinds is
required. An object that rotates on the spot neither translates nor has a net shear force. Its shear
is uniform along the circles about the center.

The used fraction of the friction limit needs the coefficient. So does the sticking fraction of the
area, (1 - Q / mu N)^(2/3) (Cattaneo 1938, Mindlin 1949). The coefficient comes from the sensor
file, until a slip or a hold beyond it changes it. A used fraction close to 1 is not evidence of
slip. For an unknown object the coefficient is unknown too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.status import Status, StatusCode
from mjtactile.core.types import Array, Contact, Slip, SlipState
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.force.linearization import Shape
from mjtactile.sensing.settings import DEFAULTS, SlipSettings

# as a fraction of the peak: less is the contact's edge, with an undetermined ratio
_PRESSED = 0.1
_NODES = 6  # minimum effective number of equally loaded nodes
_ROTATION_NODES = 4  # same for rotation: shear that is uniform along circles is rarer
_ROTATION_FRACTION = 1.5  # torque over the radius of gyration, as a fraction of the force
_IMAGES = 3  # two of these must show slip: noise may make the shear of one image uniform
_ROTATION_LIMIT = 0.85  # squared, over that of a force: of a torque over the radius of gyration
_POINT = 1e-4  # minimum patch size, m; a patch of a single node has no extent


@dataclass(frozen=True, eq=False)
class SlipSample:
    """Sample of one image for slip detection. `time`, s, is that of the image. `p` (2,), m, is the
    center of pressure in material coordinates. `dragged` (3,), m, is the displacement of the rubber
    under it since the touch started. `ratio` (3,) is that of shear to normal force. `turning` is
    the nonuniformity of the shear along a rotation (inf: no rotation)."""

    time: float
    p: Array
    dragged: Array
    ratio: Array
    turning: float = np.inf


@dataclass(frozen=True, eq=False)
class SlipHistory:
    """State carried to the next image. It holds the last `samples`, and the `weight` (J,) and
    `position` (J, 3), m, of the nodes. It also holds the slip `distance`, m, and the estimated
    coefficient of `friction`."""

    samples: tuple[SlipSample, ...]
    weight: Array
    position: Array
    distance: float
    friction: float


def unknown(code: StatusCode, reason: str) -> Slip:
    return Slip("unknown", np.full(2, np.nan), np.nan, np.nan, status=Status(code, reason))


def classify(
    time: float,
    estimator: InverseMembrane,
    shape: Shape,
    patches: Sequence[Contact],
    before: SlipHistory | None,
    s: SlipSettings = DEFAULTS.slip,
) -> tuple[Slip, SlipHistory | None]:
    """Return the slip state of the strongest patch at `time`, s. Also return the history for the
    next image (None: the touch has ended)."""
    if not patches:
        return Slip("none", np.zeros(2), 0.0, 1.0), None
    normal, shear = split(patches[0].force, mean_normal(estimator, shape))
    if normal < s.min_force:
        return unknown(
            StatusCode.FORCE_TOO_LOW,
            f"the force of {normal:.3f} N is too small for a slip estimate",
        ), before
    around, used_around = turning(estimator, shape)
    around = around if used_around > s.min_load else np.inf
    uneven, is_finite_value = shear_nonuniformity(estimator, shape, shear)
    now = _follow(time, estimator, shape, (shear / normal, around), before, s)
    load = float(np.linalg.norm(shear)) / normal
    velocity, displacement = _motion(now.samples, s)
    required = s.evidence if uneven < s.sticks else s.evidence_uneven
    is_even = is_finite_value and uneven < s.even
    # the center sticks, in whatever direction the contact moves
    rolls = is_finite_value and uneven > s.rolls
    goes = not rolls and displacement > s.min_displacement and evidence(now, normal, s) > required
    slips = load > s.min_load and (is_even or goes)
    if not slips and _turns(now.samples, s):
        slips = True
        load = used_around
    if slips and now.distance == 0:
        slid = max(now.distance, displacement)
    else:
        slid = now.distance + slips * _latest_direction(now.samples)
    friction = load if slips else max(now.friction, load)
    used = load / friction
    state: SlipState = "slipping" if slips else "incipient" if used > s.incipient else "sticking"
    stick = 0.0 if slips else max(0.0, 1 - used) ** (2 / 3)
    return Slip(state, velocity, slid, stick), replace(now, distance=slid, friction=friction)


def shear_nonuniformity(
    estimator: InverseMembrane, shape: Shape, shear: Array
) -> tuple[float, bool]:
    """Return the ratio of spread to mean of shear over pressure along the shear force (3,), N,
    weighted by the normal force: 0 under full sliding. Only nodes with at least a tenth of the peak
    pressure count. Also return True if enough nodes are loaded: a single node is always uniform."""
    press = np.maximum(-shape.traction[2], 0.0)
    inside = press > _PRESSED * press.max()
    weight = (press * estimator.node_area)[inside]
    weight = weight / weight.sum()
    direction = shear[:2] / max(float(np.linalg.norm(shear[:2])), 1e-12)
    ratio = (direction @ shape.traction[:2, inside]) / press[inside]
    mean = float(weight @ ratio)
    spread = float(np.sqrt(weight @ (ratio - mean) ** 2))
    return spread / max(abs(mean), 1e-9), float(weight @ weight) * _NODES < 1


def turning(estimator: InverseMembrane, shape: Shape) -> tuple[float, float]:
    """Return the nonuniformity of the shear along a rotation on the spot.

    One rigid object has a force f and a torque t per newton of normal force. Its sliding velocity
    is f + (t / c^2) z x (r - r0). Here the limits of both form an ellipse, and the motion is normal
    to it (Howe & Cutkosky 1996). Each part of the contact is dragged in that direction by friction
    alone.

    Args:
        estimator: Membrane model that defines the nodes.
        shape: With the tractions.

    Returns:
        Ratio of spread to mean of the shear over pressure along that direction, and the mean.
        Weights are the normal force and the local speed. The ratio is 0 under full sliding. It is
        inf if translation dominates, or if too few nodes are loaded.
    """
    press = np.maximum(-shape.traction[2], 0.0)
    inside = press > _PRESSED * press.max()
    weight = (press * estimator.node_area)[inside]
    weight = weight / weight.sum()
    positions = estimator.node_positions(shape.c)[inside, :2]
    ratio = (shape.traction[:2, inside] / press[inside]).T
    force = weight @ ratio
    arm = positions - weight @ positions
    radius = max(float(np.sqrt(weight @ (arm**2).sum(axis=1))), _POINT)
    torque = float(weight @ (arm[:, 0] * ratio[:, 1] - arm[:, 1] * ratio[:, 0])) / radius
    around = np.stack([-arm[:, 1], arm[:, 0]], axis=1) / radius
    velocity = force + torque / _ROTATION_LIMIT * around
    speed = np.linalg.norm(velocity, axis=1)
    along = (ratio * velocity).sum(axis=1) / np.maximum(speed, 1e-9)
    fraction = weight * speed / max(float(weight @ speed), 1e-12)
    mean = float(fraction @ along)
    goes_straight = abs(torque) < _ROTATION_FRACTION * float(np.linalg.norm(force))
    if goes_straight or float(weight @ weight) * _ROTATION_NODES > 1:
        return np.inf, mean
    return float(np.sqrt(fraction @ (along - mean) ** 2)) / max(abs(mean), 1e-9), mean


def _turns(samples: Sequence[SlipSample], s: SlipSettings) -> bool:
    """Return True if the newest image and one of the two before show rotational sliding."""
    observed = [sample.turning < s.uniform_rotation for sample in samples[-_IMAGES:]]
    return observed[-1] and sum(observed) > 1


def evidence(history: SlipHistory, normal: float, s: SlipSettings = DEFAULTS.slip) -> float:
    """Return the displacement of the center of pressure along the shear, in standard deviations.
    The displacement is a ramp that started within the last `s.recent` s. The part explained by the
    rubber's own motion and by tilting is subtracted (Eq. F14). `normal` is the normal force, N."""
    samples = history.samples
    time = np.array([sample.time for sample in samples])
    along = samples[-1].ratio / max(float(np.linalg.norm(samples[-1].ratio)), 1e-12)
    displacement = np.array([sample.p for sample in samples]) @ along[:2]
    dragged = np.array([sample.dragged for sample in samples]) @ along
    ratio = np.array([sample.ratio for sample in samples]) @ along
    size, length = _extent(history, along)
    size = max(size, _POINT)
    sd = s.noise * (size / s.noise_size) ** s.noise_size_power * normal**s.noise_force_power
    lean = s.lean * (length / s.noise_size) ** s.lean_power
    maximum = 0.0
    for b in range(s.min_before, len(samples)):  # the first image of the ramp
        if time[-1] - time[b] > s.recent:
            continue
        a = int(np.searchsorted(time, time[b] - s.baseline))
        # since then, relative to the mean of a period before
        went = displacement[b:] - displacement[a:b].mean()
        was_dragged = dragged[b:] - dragged[a:b].mean()
        leant = ratio[b:] - ratio[a:b].mean()
        left = went - s.follows * np.abs(was_dragged) - lean * np.abs(leant)
        if left[-1] > s.min_displacement:
            ramp = time[b:] - time[b - 1]
            ramp_sd = sd * float(np.sqrt(ramp @ ramp + ramp.sum() ** 2 / (b - a)))
            maximum = max(maximum, float(ramp @ left) / ramp_sd)
    return maximum


def _follow(
    time: float,
    estimator: InverseMembrane,
    shape: Shape,
    shear: tuple[Array, float],
    before: SlipHistory | None,
    s: SlipSettings,
) -> SlipHistory:
    """Return the history with the newest image's sample, whose `ratio` and `turning` are `shear`.
    The history is reset at the start of the touch, and after a gap."""
    weight = _pressed(estimator, shape, s.core_fraction)
    position = estimator.node_positions(shape.c)
    p = weight @ estimator.nodes
    if before is None or not 0 < time - before.samples[-1].time < s.gap:
        friction = estimator.design.membrane.friction if before is None else before.friction
        first = SlipSample(time, p, np.zeros(3), *shear)
        return SlipHistory((first,), weight, position, 0.0, friction)
    step = 0.5 * (weight + before.weight) @ (position - before.position)
    sample = SlipSample(time, p, before.samples[-1].dragged + step, *shear)
    kept = tuple(old for old in before.samples if time - old.time < s.recent + s.baseline)
    return replace(before, samples=(*kept, sample), weight=weight, position=position)


def _motion(samples: Sequence[SlipSample], s: SlipSettings) -> tuple[Array, float]:
    """Compute the velocity (2,), m/s, of the center of pressure over the material. Also return its
    path along the shear, m. Both are over the last `s.recent` s."""
    first = next(old for old in samples if samples[-1].time - old.time <= s.recent)
    displacement = samples[-1].p - first.p
    elapsed = samples[-1].time - first.time
    along = samples[-1].ratio[:2] / max(float(np.linalg.norm(samples[-1].ratio)), 1e-12)
    return (displacement / elapsed if elapsed > 0 else np.zeros(2)), float(displacement @ along)


def _latest_direction(samples: Sequence[SlipSample]) -> float:
    """Return the displacement of the center of pressure in the newest image, m."""
    if len(samples) > 1:
        return float(np.linalg.norm(samples[-1].p - samples[-2].p))
    return 0.0


def _extent(history: SlipHistory, along: Array) -> tuple[float, float]:
    """Return the radius of gyration of the pressure, m, and its standard deviation along the
    direction (3,)."""
    centered = history.position - history.weight @ history.position
    radius = float(np.sqrt(history.weight @ (centered**2).sum(axis=1)))
    length = float(np.sqrt(history.weight @ (centered[:, :2] @ along[:2]) ** 2))
    return radius, length


def split(force: Array, normal: Array) -> tuple[float, Array]:
    """Return the normal force, N, and the shear (3,), N, of a force on a patch. The patch has the
    outward unit normal (3,). The normal force is positive for compression."""
    along = float(force @ normal)
    return -along, force - along * normal


def mean_normal(estimator: InverseMembrane, shape: Shape) -> Array:
    """Return the outward unit normal (3,) of the membrane, averaged over the contact."""
    weight = estimator.pressing_at_points(shape)
    n = estimator.membrane.area_vector(shape.c, weight)
    if weight.any():
        return n / max(float(np.linalg.norm(n)), 1e-30)
    return np.array([0.0, 0.0, 1.0])


def _pressed(estimator: InverseMembrane, shape: Shape, core_fraction: float) -> Array:
    """Return the fraction (J,) of the normal contact force at each node. Nodes below
    `core_fraction` of the peak count as no contact."""
    weight = np.maximum(-shape.traction[2], 0.0) * estimator.node_area
    weight = np.maximum(weight - core_fraction * weight.max(), 0.0)
    return weight / weight.sum()
