"""Numbers of the paper's own methods, which the default chain is compared with."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.sensing.settings.number import number


@dataclass(frozen=True)
class PaperSettings:
    """The paper's levels as a chain of their own."""

    touch_sd: float = number(
        4.0, "sd of the area's calibration that a force must exceed to be a touch", "trial"
    )
    touch_least: float = number(0.04, "N that it must exceed too", "trial")
    outline_share: float = number(
        0.5,
        "of the greatest pressure: where a contact's outline lies",
        "smoothed by the marker spacing, a plateau's rim lies at half of it",
    )
    taper: float = number(
        1.25, "pitches over which the test function falls", "at least one marker must see it; trial"
    )
    informative_pressure: float = number(
        100.0, "Pa; below, the bulge is too small to tell the stiffness", "trial"
    )


DEFAULTS = PaperSettings()
