"""Gas of the chambers: its law within a step, and its heat between steps (equation G4)."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class Gas:
    """Gas of all membranes: p V^gamma, or the gauge pressure, Pa, where not sealed; flat volume."""

    amount: wp.array(dtype=float)
    sealed: wp.array(dtype=int)
    flat: float
    ambient: float
    exponent: float


@wp.struct
class Heat:
    """Gas of all membranes between steps (equation G4 of docs/theory).

    `amount` (F,) is n R T of the walls, J. `warmth` the gas temperature over that of the walls;
    `volume` m^3 at the last step. `supply` the gauge pressure, Pa, behind an open valve.
    `exchange` is the time step over the time constant of heat exchange.
    """

    amount: wp.array(dtype=float)
    warmth: wp.array(dtype=float)
    volume: wp.array(dtype=float)
    supply: wp.array(dtype=float)
    exchange: float
    gamma: float


@wp.func
def _ramp(x: float) -> float:
    """Return (1 - exp(-x)) / x."""
    found = float(1.0)
    if wp.abs(x) > 1.0e-4:
        found = (1.0 - wp.exp(-x)) / x
    return found


@wp.func
def before_solution(gas: Gas, heat: Heat, f: int) -> None:
    """Write the gas law of the coming step: p V^gamma with the heat lost within the step."""
    if gas.sealed[f] != 0:
        x = heat.exchange
        warmth = heat.warmth[f] * wp.exp(-x) + x * _ramp(x)
        # at constant volume. `gas.exponent` has the response to a change of volume
        absolute = heat.amount[f] * warmth / heat.volume[f]
        gas.amount[f] = absolute * wp.pow(heat.volume[f], gas.exponent)
    else:
        gas.amount[f] = heat.supply[f]


@wp.func
def after_solution(gas: Gas, heat: Heat, f: int, pressure: float, bulge: float) -> None:
    """Advance the gas to its new volume."""
    volume = gas.flat + bulge
    if gas.sealed[f] != 0:
        x = heat.exchange
        decay = (heat.gamma - 1.0) * wp.log(volume / heat.volume[f]) + x
        heat.warmth[f] = heat.warmth[f] * wp.exp(-decay) + x * _ramp(decay)
    else:
        heat.warmth[f] = 1.0
        heat.amount[f] = (pressure + gas.ambient) * volume
    heat.volume[f] = volume
