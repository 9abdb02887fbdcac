"""The paper's own way from markers to force, as a chain of its own: what the default chain is
compared with.

The net force comes from the change of area (dF = c dA, Eq. 11), its distribution from a grid of
springs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.paper.contact import find_contact, resample
from benchmarks.paper.levels import spring_grid_force
from benchmarks.paper.settings import DEFAULTS as PAPER
from mjtactile.calibrate.area import AreaCalibration
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import DeviceError
from mjtactile.core.status import StatusCode
from mjtactile.core.types import Markers, Surface, Touch, Traction
from mjtactile.sensing.chain import Chain, ChainState
from mjtactile.sensing.settings import DEFAULTS, Settings
from mjtactile.sensing.touch import slip


class PaperChain(Chain):
    """A `Chain` whose force is the paper's, with its constant c in `area_calibration`."""

    def __init__(
        self,
        design: SensorDesign,
        area_calibration: AreaCalibration,
        *,
        settings: Settings = DEFAULTS,
    ):
        super().__init__(design, settings=settings)
        self.area_calibration = area_calibration

    def feel(
        self, state: ChainState, markers: Markers, surface: Surface, time: float
    ) -> tuple[Touch, ChainState]:
        """Force by the paper's levels 1 and 2."""
        if state.reference is None:
            raise DeviceError(f"sensor {self.design.name}: markers before the rest reference")
        rest = state.reference.surface
        traction = self._traction(surface, rest)
        force = -float(traction.wrench[2])
        sd = float(np.sqrt(traction.wrench_cov[2, 2]))
        s = PAPER
        touching = force > max(s.touch_least, s.touch_sd * sd)
        contact = find_contact(surface, rest, traction, touching=touching, s=s)
        return Touch(
            time,
            0.0,
            force,
            sd,
            touching,
            contact=contact,
            traction=traction,
            surface=surface,
            markers=markers,
            slip=slip.unknown(StatusCode.NOT_ESTIMATED, "needs membrane statics"),
        ), state

    def _traction(self, surface: Surface, rest: Surface) -> Traction:
        """dF = c dA for the sum, a grid of springs for how it is spread."""
        x = self.inverse.x
        y = self.inverse.y
        now, before = (replace(s, x=x, y=y, z=resample(s, x, y)) for s in (surface, rest))
        nodal = spring_grid_force(now, before, self.design.membrane.pretension)
        wrench = np.zeros(6)
        cov = np.zeros((6, 6))
        wrench[2] = -self.area_calibration.force(surface.area - rest.area)
        cov[2, 2] = (
            self.area_calibration.residual**2
            + (self.area_calibration.constant * surface.area_sd) ** 2
        )
        return Traction(x, y, nodal, wrench, cov, np.nan, method="paper")
