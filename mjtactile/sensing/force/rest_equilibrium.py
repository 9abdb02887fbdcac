"""Membrane of a sensor with its markers, without contact (docs/theory/membrane_inverse.md, Eq.
F25).

The bulge is computed by the membrane model of `mjtactile.sensing.force.spline_fem`, not
interpolated. The stiffness is fitted to the markers at rest.

A contact makes the membrane appear stiffer, which this fit would absorb. But it also changes the
shape of the bulge (Eq. F16). The residual heights are compared with all errors possible without
contact: noise, discretization of the model, and the lens. An uncalibrated lens scales heights by an
error that varies smoothly over the image, and grows with the flat membrane's marker deviations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import DeviceError
from mjtactile.core.types import Array, Markers
from mjtactile.sensing.force.spline_fem import FEWEST_SPANS, Gas, SplineMembrane, State
from mjtactile.sensing.force.stress_relaxation import RelaxingMembrane
from mjtactile.sensing.settings import DEFAULTS, InverseSettings, ReferenceSettings, Settings

_GAS_NEAR = 3.0  # pressure difference for which the rest shape is kept, Pa
_REST_STEPS = 6  # the bulge scales with the stiffness to a power between -1 and -1/3


@dataclass(frozen=True, eq=False)
class InverseRest:
    """Rest state that the sensor measured without contact.

    `gas` is the gas. `stiffness_scale` is the apparent stiffness of the bulge relative to the
    sensor file. It is attributed to the factors `young` on Young's modulus and `stretch` on the
    pre-stretch (Eq. F25). `c` (3, n), m, are the coefficients of the model with the markers' bulge.
    `offset` (N, 3), m, is the remainder: measured minus modeled marker positions.

    With a pressure sensor, `gas_sd`, Pa, is the standard deviation of the pressure. It holds in a
    chamber of `gas_volume`, m^3. `gauge_pressure`, Pa, is the pressure at rest. `darkness` (N,) is
    that of the markers at rest; NaN, or None: unknown. For rubber with relaxation, the scale refers
    to the long-term modulus. `faded` (3, qx, qy), N/m, is the relaxed part of the instantaneous
    stress; None: no relaxation.
    """

    gas: Gas
    stiffness_scale: float
    c: Array
    offset: Array
    gas_sd: float | None = None
    gas_volume: float = math.nan
    gauge_pressure: float = math.nan
    darkness: Array | None = None
    faded: Array | None = None
    young: float = 1.0
    stretch: float = 1.0


class MarkedMembrane:
    """Membrane of one sensor with its markers."""

    def __init__(self, design: SensorDesign, settings: InverseSettings):
        self.design = design
        self.settings = settings
        self.membrane = SplineMembrane(design, _spans(design, settings))
        relaxation = design.relaxation
        self.rubber = None if relaxation is None else RelaxingMembrane(self.membrane, relaxation)
        self._quick = 1.0 if relaxation is None else relaxation.quick
        self._material = design.markers.p_SM
        self._seats = np.ascontiguousarray(self.membrane.parametric(self._material[:, :2]))
        self._at_markers = self.membrane.basis(self._seats)

    def rest_state(
        self,
        markers: Markers,
        gauge_pressure: float,
        *,
        sealed: bool = True,
        inflated_s: float = math.inf,
    ) -> InverseRest:
        """Calibrate on a state without contact and with a known gauge pressure, Pa. The membrane
        has been in this state for `inflated_s` s. For the result see `InverseRest`."""
        valve = Gas(gauge_pressure)
        scale = young = stretch = 1.0
        c = self.membrane.equilibrium(valve)
        height = markers.p_SM[:, 2]
        if gauge_pressure > self.settings.informative_pressure:
            for _ in range(_REST_STEPS):
                modelled = self._at_markers[markers.ids] @ c[2]
                # membrane indented below the frame: no bulge
                ratio = max(float(modelled @ height / (modelled @ modelled)), 0.01)
                scale *= np.clip(1 / ratio**self.settings.rest_power, 0.5, 2.0)
                young, stretch = self._separate(scale, c)
                faded = self._faded(c, young, inflated_s)
                quick = young * self._quick
                c = self.membrane.equilibrium(valve, quick, start=c, faded=faded, stretch=stretch)
        faded = self._faded(c, young, inflated_s)
        state = self.membrane.state(c, young * self._quick, faded, stretch)
        gas = self.membrane.seal(state, gauge_pressure) if sealed else valve
        offset = np.zeros((self.design.markers.count, 3))
        offset[markers.ids] = markers.p_SM - self.positions(c)[markers.ids]
        darkness = np.full(self.design.markers.count, np.nan)
        if markers.darkness is not None:
            darkness[markers.ids] = markers.darkness
        return InverseRest(
            gas, scale, c, offset, darkness=darkness, faded=faded, young=young, stretch=stretch
        )

    def _separate(self, scale: float, c: Array) -> tuple[float, float]:
        """Return the factors on Young's modulus and pre-stretch for an apparent stiffness `scale`
        (Eq. F25). The membrane bulges at `c`. Each factor deviates in proportion to its variance,
        and the pre-stretch by at most three standard deviations."""
        s = self.settings
        nominal = self.design.membrane.pre_stretch
        strain = nominal - 1 + self.membrane.mean_strain(c)
        uncertainty = s.pre_stretch_sd / max(strain, s.pre_stretch_sd)
        fraction = uncertainty**2 / (uncertainty**2 + s.young_sd**2)
        more = float(np.clip(strain * (scale**fraction - 1) / s.pre_stretch_sd, -3, 3))
        more *= s.pre_stretch_sd
        return scale / (1 + more / strain), 1 + more / nominal

    def volume(self, c: Array) -> float:
        """Return the gas volume, m^3, behind the membrane at coefficients `c`."""
        return self.design.chamber_volume_flat + self.membrane.state(c).volume

    def with_gas(self, rest: InverseRest, gas: Gas, sd: float, volume: float) -> InverseRest:
        """Return the rest state of the same sensor, filled with `gas`. The standard deviation of
        its pressure is `sd`, Pa, in a chamber of `volume`, m^3."""
        rest = self.at_rest(replace(rest, gas=gas))
        return replace(rest, gas_sd=sd, gas_volume=volume)

    def at_rest(self, rest: InverseRest) -> InverseRest:
        """Return the rest state with shape and pressure updated to its gas and relaxed stress."""
        c = rest.c
        state = self.state(c, rest)
        # pressure that best balances the elastic forces of this bulge
        held = float((state.elastic * state.gradient).sum() / (state.gradient**2).sum())
        if abs(self.membrane.gas_pressure(state, rest.gas)[0] - held) > _GAS_NEAR:
            scale = rest.young * self._quick
            c = self.membrane.equilibrium(
                rest.gas, scale, start=c, faded=rest.faded, stretch=rest.stretch
            )
            held = self.membrane.gas_pressure(self.membrane.state(c), rest.gas)[0]
        return replace(rest, c=c, gauge_pressure=held)

    def state(self, c: Array, rest: InverseRest) -> State:
        """Return the state of this sensor's membrane at coefficients `c` (3, n), m."""
        return self.membrane.state(c, rest.young * self._quick, rest.faded, rest.stretch)

    def _faded(self, c: Array, scale: float, inflated_s: float) -> Array | None:
        """Return the relaxed stress (3, qx, qy), N/m, of a membrane at `c` since `inflated_s` s."""
        return None if self.rubber is None else self.rubber.start(c, scale, inflated_s, 0.0).total

    def positions(self, c: Array) -> Array:
        """Return the marker centers (N, 3), m, in S."""
        return self._material + self._at_markers @ c.T


def _spans(design: SensorDesign, settings: InverseSettings) -> tuple[int, int]:
    """Return the number of spline intervals along x and y."""
    nx, ny = settings.spans
    if design.frame.outline is None:
        return nx, ny
    along = math.sqrt(nx * ny * design.frame.length / design.frame.width) / 2
    across = nx * ny / (4 * along)
    return max(2 * round(along), FEWEST_SPANS), max(2 * round(across), FEWEST_SPANS)


def darker(markers: Markers, rest: InverseRest) -> Array:
    """Return the change of each marker's darkness since `rest` (m,); 0 if unknown."""
    if markers.darkness is None or rest.darkness is None:
        return np.zeros(len(markers))
    changed = markers.darkness - rest.darkness[markers.ids]
    changed[~(np.abs(changed) < np.inf)] = 0.0
    return changed


def bulge_misfit(
    design: SensorDesign,
    markers: Markers,
    z: Array,
    flat_px: float,
    *,
    lens_measured: bool,
    s: ReferenceSettings = DEFAULTS.reference,
) -> float:
    """Return the mean square misfit of the markers' heights to the best-fitting bulge's `z` (n,),
    m, over its variance. `flat_px` is the rms residual of the flat reference."""
    x, y = (markers.p_SM[:, :2] / (design.frame.length / 2, design.frame.width / 2)).T
    fraction = s.lens_fraction_measured if lens_measured else s.lens_fraction
    modes = fraction * z[:, None] * np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    lens = (s.lens_rest + s.lens_rest_per_px * flat_px) * z
    variance = markers.cov_p[:, 2, 2] + s.bulge_floor**2 + lens**2
    residual = markers.p_SM[:, 2] - z
    return float(residual @ np.linalg.solve(modes @ modes.T + np.diag(variance), residual)) / len(
        residual
    )


def require_bulge(
    design: SensorDesign,
    markers: Markers,
    z: Array,
    rest: InverseRest,
    flat_px: float,
    *,
    lens_measured: bool,
    settings: Settings = DEFAULTS,
) -> None:
    """Raise DeviceError if the rest state is not the bulge of the sensor file, in height or shape.
    `z` (n,), m, are the marker heights of the best-fitting bulge, and `flat_px` is the rms residual
    of the flat reference."""
    gauge_pressure = rest.gas.gauge_pressure
    maximum = settings.reference.stiffness_off_max
    if not 1 / maximum < rest.stiffness_scale < maximum:
        height = 1e3 * float(np.abs(markers.p_SM[:, 2]).max())
        raise DeviceError(
            f"sensor {design.name}: at {gauge_pressure:.0f} Pa the markers are at most "
            f"{height:.2f} mm high, as if the membrane were {rest.stiffness_scale:.1f} times "
            "as stiff as in the sensor file; check that the valve moves, and young_MPa and "
            "thickness_mm of the membrane"
        )
    # hardly a bulge, and no stiffness was fitted to it
    if gauge_pressure <= settings.inverse.informative_pressure:
        return
    s = settings.reference
    squares = bulge_misfit(design, markers, z, flat_px, lens_measured=lens_measured, s=s)
    if squares > s.bulge_misfit_max:
        deviation = 1e3 * float(np.abs(markers.p_SM[:, 2] - z).max())
        raise DeviceError(
            f"sensor {design.name}: at rest the membrane does not have the bulge expected at "
            f"{gauge_pressure:.0f} Pa: markers deviate by up to {deviation:.2f} mm "
            f"({np.sqrt(squares):.1f} standard deviations, rms); remove any contact, else "
            "measure the lens: `mjtactile calibrate camera`"
        )
