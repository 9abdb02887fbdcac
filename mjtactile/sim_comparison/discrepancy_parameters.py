"""Possible causes of a difference between a rig and its simulation.

Each is one parameter of the simulator. `CAUSES` is the whole list. A cause of a sensor has one
value per finger. A cause of the gripper or of the object has one value.

Some quantities cannot be set exactly (position of the object, offset of the jaws from their
reading). These have a `spread`. They serve as nuisance parameters for every other cause.
"""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.core.config_fields import ML_S_KPA


@dataclass(frozen=True)
class DiscrepancyParameter:
    """Parameter in which a rig may differ from its simulation.

    Attributes:
        name: Key of the cause in results.
        more: Description for a positive value; {amount} includes its unit.
        less: Description for a negative value.
        probe: Change in the simulator that measures its effect, SI.
        scale: Number of SI units in one `unit`.
        unit: Displayed unit.
        remedy: Recommended action.
        spread: Standard deviation as a nuisance parameter of other causes, SI; 0: none.
        low: Minimum value, SI.
        on: Location: "sensor", "gripper", "object" or "stage".
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


_FIT = "mjtactile fit --recording RECORDING estimates it, from indentations with a known indenter"
CAUSES: tuple[DiscrepancyParameter, ...] = (
    DiscrepancyParameter(
        "leak",
        "gas leaks, {amount}",
        "",
        1e-2 * ML_S_KPA,
        ML_S_KPA,
        "mL/(s kPa)",
        "search for the leak; doctor measures the pressure loss of a chamber, and fit "
        "estimates the leak",
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
        "the membrane is stretched more, by {amount}",
        "the membrane is stretched less, by {amount}",
        0.01,
        1.0,
        "of its length",
        _FIT,
    ),
    DiscrepancyParameter(
        "creep",
        "the stress of the rubber decays by {amount} more per decade of time",
        "",
        0.05,
        0.01,
        "%",
        "mjtactile fit --relaxation RECORDING estimates it, from a membrane that stays inflated",
        low=0.0,
    ),
    DiscrepancyParameter(
        "friction",
        "the friction of the membrane is higher by {amount}",
        "the friction of the membrane is lower by {amount}",
        -0.3,
        0.01,
        "%",
        "drag an indenter over the membrane (protocol drag), and fit",
        low=-0.95,
    ),
    DiscrepancyParameter(
        "gauge",
        "the pressure sensor reads {amount} more",
        "the pressure sensor reads {amount} less",
        40.0,
        1.0,
        "Pa",
        "mjtactile calibrate valve measures its zero",
    ),
    DiscrepancyParameter(
        "focal",
        "the focal length is greater by {amount}",
        "the focal length is smaller by {amount}",
        0.01,
        0.01,
        "%",
        "mjtactile calibrate camera measures the lens",
    ),
    DiscrepancyParameter(
        "opening",
        "the jaws are {amount} farther apart than reported, or the object is thinner",
        "the jaws are {amount} closer together than reported, or the object is thicker",
        -3e-4,
        1e-3,
        "mm",
        "mjtactile calibrate gripper measures the jaws",
        spread=3e-4,
        on="gripper",
    ),
    DiscrepancyParameter(
        "along",
        "the object is {amount} farther along the table's x",
        "the object is {amount} less far along the table's x",
        1.5e-3,
        1e-3,
        "mm",
        "place the object again; the sensors have no fault",
        spread=2e-3,
        on="object",
    ),
    DiscrepancyParameter(
        "mass",
        "the object is heavier by {amount}",
        "the object is lighter by {amount}",
        0.3,
        0.01,
        "%",
        "weigh the object, and set the mass in its file",
        on="object",
        low=-0.9,
    ),
    DiscrepancyParameter(
        "touch",
        "the indenter is {amount} deeper than specified",
        "the indenter is {amount} less deep than specified",
        1e-4,
        1e-3,
        "mm",
        "detect the first touch again",
        spread=1e-4,
        on="stage",
    ),
)
IN_STOCK = ("sensor", "gripper", "object")
ON_STAGE = ("sensor", "stage")


def causes_of(staged: bool, names: tuple[str, ...] = ()) -> tuple[DiscrepancyParameter, ...]:
    """Return the (named) causes that apply to a recording of a stage or a gripper."""
    locations = ON_STAGE if staged else IN_STOCK
    return tuple(
        cause for cause in CAUSES if cause.on in locations and (not names or cause.name in names)
    )


def words(cause: DiscrepancyParameter, amount: float) -> str:
    """Return a description of the amount of a cause."""
    text = cause.more if amount >= 0 or not cause.less else cause.less
    shown = abs(amount) / cause.scale
    return text.format(amount=f"{shown:.2g} {cause.unit}")
