"""Parameters of the paper's own methods, baselines of the default chain."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.sensing.settings.tunable_parameter import number


@dataclass(frozen=True)
class PaperSettings:
    """Settings of `benchmarks.paper.force_methods`."""

    taper: float = number(
        1.25, "pitches over which the test function falls", "at least one marker inside; trial"
    )
    informative_pressure: float = number(
        100.0, "Pa; below, the bulge is too small to determine the stiffness", "trial"
    )


DEFAULTS = PaperSettings()
