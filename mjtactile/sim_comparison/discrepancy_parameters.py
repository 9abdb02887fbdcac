"""Possible causes of a difference between a rig and its simulation, each one number for the
simulator.

`CAUSES` is the whole list. A cause of a sensor has one value per finger; a cause of the gripper or
of the object has one value. Quantities that cannot be set exactly (position of the object, offset
of the jaws from their reading) have a `spread`. They serve as nuisance parameters for every other
cause.
"""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.core.config_fields import ML_S_KPA


@dataclass(frozen=True)
class DiscrepancyParameter:
    """One number in which a rig may differ.

    Attributes:
        name: Key of the cause in results.
        more: Description for a positive number; {amount} includes its unit.
        less: Description for a negative number.
        probe: Change in the simulator that measures its effect, SI.
        scale: Number of SI units in one `unit`.
        unit: Displayed unit.
        remedy: Recommended action.
        spread: Standard deviation as a nuisance parameter of other causes, SI; 0: none.
        low: Minimum value, SI.
        on: Location: "sensor", "hand", "thing" or "stage".
    """

    name: str
    more: str
    less: str
    probe: float
    scale: float
    unit: str
    remedy: str
    spread: float = 0.0
    low: float = -float("inf")
    on: str = "sensor"


_FIT = "mjtactile fit --recording RECORDING finds it, from presses with a known indenter"
CAUSES: tuple[DiscrepancyParameter, ...] = (
    DiscrepancyParameter(
        "leak",
        "gas leaks, {amount}",
        "",
        1e-2 * ML_S_KPA,
        ML_S_KPA,
        "mL/(s kPa)",
        "look for the hole; doctor measures a chamber's loss, and fit what it is",
        low=0.0,
    ),
    DiscrepancyParameter(
        "stiffness",
        "the rubber is stiffer by {amount}",
        "the rubber is softer by {amount}",
        0.15,
        0.01,
        "%",
        _FIT,
        low=-0.8,
    ),
    DiscrepancyParameter(
        "pre_stretch",
        "the sheet is stretched more, by {amount}",
        "the sheet is stretched less, by {amount}",
        0.01,
        1.0,
        "of its length",
        _FIT,
    ),
    DiscrepancyParameter(
        "creep",
        "the rubber's stress fades by {amount} more in each decade of time",
        "",
        0.05,
        0.01,
        "%",
        "mjtactile fit --relaxation RECORDING finds it, from a membrane that is left inflated",
        low=0.0,
    ),
    DiscrepancyParameter(
        "friction",
        "the membrane is rougher by {amount}",
        "the membrane is slipperier by {amount}",
        -0.3,
        0.01,
        "%",
        "drag a pressed indenter (protocol drag), and fit",
        low=-0.95,
    ),
    DiscrepancyParameter(
        "gauge",
        "the pressure sensor shows {amount} more",
        "the pressure sensor shows {amount} less",
        40.0,
        1.0,
        "Pa",
        "mjtactile calibrate valve measures its zero",
    ),
    DiscrepancyParameter(
        "focal",
        "the lens is longer by {amount}",
        "the lens is shorter by {amount}",
        0.01,
        0.01,
        "%",
        "mjtactile calibrate camera measures the lens",
    ),
    DiscrepancyParameter(
        "opening",
        "the jaws stand {amount} farther apart than they say, or the thing is thinner",
        "the jaws stand {amount} closer than they say, or the thing is thicker",
        -3e-4,
        1e-3,
        "mm",
        "mjtactile calibrate gripper measures the jaws",
        spread=3e-4,
        on="hand",
    ),
    DiscrepancyParameter(
        "along",
        "the thing stands {amount} farther along the table's x",
        "the thing stands {amount} less far along the table's x",
        1.5e-3,
        1e-3,
        "mm",
        "place it again; it is no fault of a sensor",
        spread=2e-3,
        on="thing",
    ),
    DiscrepancyParameter(
        "mass",
        "the thing is heavier by {amount}",
        "the thing is lighter by {amount}",
        0.3,
        0.01,
        "%",
        "weigh it, and say so in its file",
        on="thing",
        low=-0.9,
    ),
    DiscrepancyParameter(
        "touch",
        "the indenter is {amount} deeper than said",
        "the indenter is {amount} less deep than said",
        1e-4,
        1e-3,
        "mm",
        "look for first touch again",
        spread=1e-4,
        on="stage",
    ),
)
IN_STOCK = ("sensor", "hand", "thing")
ON_STAGE = ("sensor", "stage")


def causes_of(staged: bool, names: tuple[str, ...] = ()) -> tuple[DiscrepancyParameter, ...]:
    """Those that a recording of a stage, or of a hand, can have; of `names` alone, if there are
    any."""
    places = ON_STAGE if staged else IN_STOCK
    return tuple(
        cause for cause in CAUSES if cause.on in places and (not names or cause.name in names)
    )


def words(cause: DiscrepancyParameter, amount: float) -> str:
    """Return a description of the amount of a cause."""
    text = cause.more if amount >= 0 or not cause.less else cause.less
    shown = abs(amount) / cause.scale
    return text.format(amount=f"{shown:.2g} {cause.unit}")
