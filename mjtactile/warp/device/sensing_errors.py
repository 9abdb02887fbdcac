"""Touch that the sensing pipeline would estimate, in all worlds (`-mesh,-pipeline`).

The model is `mjtactile.sim.sensing_error_model`.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

COLUMNS = 30
# columns of the table, as in `kernels/synthetic_errors.c`
MEAN = wp.constant(0)
SD = wp.constant(6)
FRESH = wp.constant(12)
OUTLIERS = wp.constant(24)
UNKNOWN = wp.constant(25)
BETWEEN = wp.constant(29)

vec6 = wp.types.vector(length=6, dtype=float)


@wp.struct
class ErrorModel:
    """Errors of a pipeline: loads (k,) N and columns (k, 30); matrices (6, 6)."""

    loads: wp.array(dtype=float)
    table: wp.array2d(dtype=float)
    gain: wp.array2d(dtype=float)
    spread: wp.array2d(dtype=float)
    outlier_size: wp.array(dtype=float)
    slow_time: float
    shear_gain: float
    touch_force: float
    release: float


@wp.struct
class Estimates:
    """Estimates and memory of the errors of all sensors (F,).

    `wrench` (F, 6) N and N m; `known` and `touching` are 0 or 1; `slow` (F, 6) is the persistent
    error in standard deviations, `grasp` the grasp's own factors of size and shear; `random` the
    generator's state.
    """

    wrench: wp.array2d(dtype=float)
    known: wp.array(dtype=int)
    touching: wp.array(dtype=int)
    detected: wp.array(dtype=int)
    slow: wp.array2d(dtype=float)
    grasp: wp.array(dtype=wp.vec2)
    random: wp.array(dtype=wp.uint32)


@wp.func
def _at_load(model: ErrorModel, load: float, column: int) -> float:
    """Return a column at a load, interpolated; beyond the last load as there."""
    right = int(1)
    while right < model.loads.shape[0] - 1 and model.loads[right] < load:
        right += 1
    low = model.loads[right - 1]
    fraction = wp.clamp((load - low) / (model.loads[right] - low), 0.0, 1.0)
    first = model.table[right - 1, column]
    return first + fraction * (model.table[right, column] - first)


@wp.func
def _persistent(sd: float, fresh: float) -> float:
    """Return the variance of the persistent part."""
    return wp.max(sd * sd - fresh * fresh, 0.0)


@wp.func
def _correlated(model: ErrorModel, normals: vec6) -> vec6:
    out = vec6()
    for i in range(6):
        total = float(0.0)
        for k in range(i + 1):
            total += model.spread[i, k] * normals[k]
        out[i] = total
    return out


@wp.func
def restart_errors(model: ErrorModel, estimates: Estimates, f: int) -> None:
    """Sample the errors that persist in a grasp."""
    state = estimates.random[f]
    normals = vec6()
    for i in range(6):
        normals[i] = wp.randn(state)
    slow = _correlated(model, normals)
    for i in range(6):
        estimates.slow[f, i] = slow[i]
        estimates.wrench[f, i] = 0.0
    size = wp.randn(state)
    gain = model.shear_gain * wp.randn(state)
    estimates.grasp[f] = wp.vec2(size, gain)
    estimates.known[f] = 1
    estimates.touching[f] = 0
    estimates.detected[f] = 0
    estimates.random[f] = state


@wp.kernel
def restart_all(model: ErrorModel, estimates: Estimates):
    restart_errors(model, estimates, wp.tid())


@wp.kernel
def estimate_all(
    model: ErrorModel, estimates: Estimates, elapsed: float, wrench: wp.array2d(dtype=float)
):
    """Sample each sensor's estimate of the ground truth `wrench` (F, 6)."""
    f = wp.tid()
    state = estimates.random[f]
    fresh = vec6()
    fast = vec6()
    for i in range(6):
        fresh[i] = wp.randn(state)
    for i in range(6):
        fast[i] = wp.randn(state)
    is_outlier = wp.randf(state)
    is_unknown = wp.randf(state)
    estimates.random[f] = state
    fresh = _correlated(model, fresh)
    fast = _correlated(model, fast)
    load = wp.max(-wrench[f, 2], 0.0)
    kept = wp.exp(-elapsed / model.slow_time)
    new = wp.sqrt(wp.max(1.0 - kept * kept, 0.0))
    between = _at_load(model, load, BETWEEN)
    grasp = estimates.grasp[f]
    factor = wp.exp(between * (grasp[0] - between))  # the mean of its square is 1
    size = _at_load(model, load, OUTLIERS)
    for i in range(6):
        slow = kept * estimates.slow[f, i] + new * fresh[i]
        estimates.slow[f, i] = slow
        own = _at_load(model, load, FRESH + i)
        lasts = _persistent(_at_load(model, load, SD + i), own)
        at_rest = wp.min(lasts, _persistent(model.table[0, SD + i], model.table[0, FRESH + i]))
        sd = wp.sqrt(at_rest + factor * factor * (lasts - at_rest))
        if is_outlier < size:
            own = own * model.outlier_size[i]
        found = wrench[f, i] + _at_load(model, load, MEAN + i) + sd * slow + own * fast[i]
        if i < 2:
            found += grasp[1] * wrench[f, i]
        for k in range(6):
            found += model.gain[i, k] * wrench[f, k]
        estimates.wrench[f, i] = found
    if is_unknown < _at_load(model, load, UNKNOWN):
        estimates.known[f] = 0
        estimates.touching[f] = 0
        for i in range(6):
            estimates.wrench[f, i] = 0.0
    else:
        threshold = float(model.touch_force)
        if estimates.detected[f] != 0:
            threshold = model.release * model.touch_force
        estimates.detected[f] = 0
        if -estimates.wrench[f, 2] > threshold:
            estimates.detected[f] = 1
        estimates.known[f] = 1
        estimates.touching[f] = estimates.detected[f]
