"""Membrane in equilibrium under a rigid plane that is wider than the frame.

See docs/theory/membrane_inverse.md, Eq. F11. The membrane of
`mjtactile.sensing.force.spline_fem` may not pass the plane. There is no friction. The plane is
fitted to the markers. The camera drift is unknown, too. The edge of the contact follows from
equilibrium. So does the load beyond the outermost markers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjtactile.core.bspline import hats
from mjtactile.core.types import Array, Markers
from mjtactile.sensing.force.linearization import PlaneContact
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from mjtactile.sensing.force.spline_fem import product
from mjtactile.sensing.force.traction_grid import LoadedMembrane

_STIFFNESS = 1e9  # stiffness of the plane, Pa/m: 5 um at 5 kPa
_NEWTON_STEPS = 30
_STEP_MAX = 5e-4  # maximum change of a coefficient per Newton step, m
_CONVERGED = 1e-7  # convergence tolerance of a Newton step, m
_FITS = 6  # fit iterations of the plane to the markers
_FITTED = (2e-7, 2e-5, 2e-5)  # convergence tolerance of the plane: height, m, and slopes
_HEIGHT_SD, _SLOPE_SD = 1e-3, 0.05  # prior standard deviations of the plane: m; rad
_PRIOR = 1 / np.array([_HEIGHT_SD, _SLOPE_SD, _SLOPE_SD]) ** 2
_OUTERMOST = 1.1  # maximum distance of an outermost marker from the frame, pitches
_PRESSING = 0.5  # fraction of the gas pressure that a marker under a face carries at least
_REACHING = 0.2  # the same for an outermost marker that the contact may reach


@dataclass(frozen=True, eq=False)
class _Equilibrium:
    """Membrane at coefficients `c` (3, n), m, under a plane. `load` (3, n), N, are the generalized
    contact forces, `pressing` (q,), N, those of the Gauss points. `pressure`, Pa, is that of the
    gas. `moved` (3, n) and `pressure_moved` (3,) are the derivatives of `c` and `pressure` by the
    parameters of the plane."""

    c: Array
    load: Array
    pressing: Array
    moved: list[Array]
    pressure: float
    pressure_moved: Array


class PlaneContactSolver:
    """Contact of one sensor's membrane with a plane. Stateless."""

    def __init__(self, loaded: LoadedMembrane):
        self._loaded = loaded
        membrane = loaded.membrane
        ax, ay = membrane.axes
        parametric = product(ax.points, ay.points)
        self._X = membrane.positions(parametric)  # (q, 2), m
        self._basis = membrane.basis(parametric)  # (q, n)
        self._stiffness = _STIFFNESS * membrane.weights.ravel()  # of each point, N/m
        overlap = np.tril(self._basis.T @ self._basis != 0)
        self._pairs = np.nonzero(overlap)
        rows = hats(loaded.x, ax.points)[0][:, 1:-1], hats(loaded.y, ay.points)[0][:, 1:-1]
        self._hats = np.einsum("qi,rj->qrij", *rows).reshape(len(parametric), -1)  # (q, J)
        seats = membrane.parametric(loaded.design.markers.p_SM[:, :2])
        at = hats(loaded.x, seats[:, 0])[0][:, 1:-1], hats(loaded.y, seats[:, 1])[0][:, 1:-1]
        layout = loaded.design.markers
        edge_distance = loaded.design.frame.inside(layout.p_SM[:, :2])
        self._outermost = edge_distance < _OUTERMOST * max(layout.pitch_x, layout.pitch_y)
        self._at_markers = np.einsum("mi,mj->mij", *at).reshape(len(seats), -1)
        self._unseen = self._unseen_areas()

    def plane_through(
        self, markers: Markers, traction: Array, pressure: float, flat: float
    ) -> Array | None:
        """Return the plane (3,) through the markers under a face.

        Args:
            markers: Detected markers.
            traction: Estimated nodal tractions (3, J), Pa.
            pressure: Gauge pressure, Pa; a flat face carries it.
            flat: Maximum deviation from the plane, in standard deviations.

        Returns:
            The plane; None if these markers are curved, or others lie beyond it.
        """
        carried = self._at_markers[markers.ids] @ -traction[2]
        under = carried > _PRESSING * max(pressure, 1.0)
        if under.sum() <= 3:
            return None
        p = markers.p_SM
        design_matrix = np.column_stack([np.ones(len(p)), p[:, :2]])
        plane, *_ = np.linalg.lstsq(design_matrix[under], p[under, 2], rcond=None)
        sd = np.sqrt(markers.cov_p[:, 2, 2] + self._loaded.settings.face_floor[2] ** 2)
        residual = (p[:, 2] - design_matrix @ plane) / sd
        curved = np.sqrt(np.square(residual[under]).mean()) > flat
        return None if curved or residual.max() > 2 * flat else plane

    def lowest(self, plane: Array) -> float:
        """Return the smallest height, m, of a `plane` (3,) over the opening."""
        return float((plane[0] + self._X @ plane[1:]).min())

    def loads_outermost(self, markers: Markers, traction: Array, pressure: float) -> bool:
        """Return True if a flat contact reaches the outermost markers. `traction` (3, J), Pa, are
        the nodal tractions, `pressure`, Pa, is that of the gas."""
        carried = self._at_markers[markers.ids] @ -traction[2]
        return bool((carried[self._outermost[markers.ids]] > _REACHING * max(pressure, 1.0)).any())

    def unseen_load(self, traction: Array, pressure: float) -> float:
        """Return the load, N, beyond the outermost markers of a flat contact that extends to the
        frame. No marker shows its end. For the arguments see `loads_outermost`."""
        pressure = max(pressure, 1.0)
        carried = np.clip(self._at_markers @ -traction[2] / pressure, 0.0, 1.0)
        return pressure * float(self._unseen @ carried)

    def _unseen_areas(self) -> Array:
        """Return the unobserved area (N,), m^2, next to each marker. It is farther than half a
        pitch from all markers."""
        layout = self._loaded.design.markers
        pitch = [layout.pitch_x, layout.pitch_y]
        offset = np.abs(self._X[:, None] - layout.p_SM[:, :2]) / pitch  # (q, N, 2)
        distance = offset.max(axis=2)
        area = np.where(distance.min(axis=1) > 0.5, self._loaded.membrane.weights.ravel(), 0.0)
        return np.bincount(distance.argmin(axis=1), area, minlength=layout.count)

    def fit(
        self,
        markers: Markers,
        observed: Array,
        weights: Array,
        drift: Array,
        rest: InverseRest,
        start: PlaneContact,
        measured: tuple[float, float] | None = None,
    ) -> PlaneContact | None:
        """Fit the plane to the positions `observed` (m, 3), m, of the markers.

        Args:
            markers: Detected markers.
            observed: Their positions without the offsets at rest.
            weights: Whitening (m, 3, 3) of the positions.
            drift: Motion (m, 3, k), m, of the markers for one standard deviation of each mode of
                drift.
            rest: Sensor at rest, with its gas.
            start: Plane and membrane to start from.
            measured: Gauge pressure, Pa, of a pressure sensor, and the standard deviation of its
                difference from the pressure of the gas; None: no pressure sensor.

        Returns:
            The contact; None if the iterations do not converge.
        """
        ids = markers.ids
        plane, c = start.plane, start.c
        modes = (weights @ drift).reshape(3 * len(ids), -1)
        inner = np.eye(modes.shape[1]) + modes.T @ modes
        at_markers = self._loaded.membrane.basis(
            self._loaded.membrane.parametric(self._loaded.design.markers.p_SM[ids, :2])
        )
        material = self._loaded.design.markers.p_SM[ids]
        for _ in range(_FITS):
            found = self._equilibrium(plane, c, rest)
            if found is None:
                return None
            c, load, pressing, moved = found.c, found.load, found.pressing, found.moved
            residual = (weights @ (observed - material - at_markers @ c.T)[..., None]).ravel()
            J = np.stack(
                [at_markers @ displacement.T for displacement in moved], axis=-1
            )  # (m, 3, 3)
            J = (weights @ J).reshape(3 * len(ids), 3)
            SJ = J - modes @ np.linalg.solve(inner, modes.T @ J)
            information = J.T @ SJ + np.diag(_PRIOR)
            score = SJ.T @ residual
            if measured is not None:
                pressure, sd = measured
                row = found.pressure_moved / sd
                information += np.outer(row, row)
                score += row * (pressure - found.pressure) / sd
            step = np.linalg.solve(information, score)
            plane = plane + step
            if (np.abs(step) < _FITTED).all():
                break
        normal = np.array([-plane[1], -plane[2], 1.0])
        log_volume = 0.5 * (np.log(_PRIOR).sum() - np.linalg.slogdet(information)[1])
        return PlaneContact(plane, c, load, self._traction(pressing, normal), float(log_volume))

    def _equilibrium(self, plane: Array, c: Array, rest: InverseRest) -> _Equilibrium | None:
        """Compute the membrane under the plane by Newton steps from `c`; None if they do not
        converge."""
        membrane = self._loaded.membrane
        normal = np.array([-plane[1], -plane[2], 1.0])
        for _ in range(_NEWTON_STEPS):
            state = self._loaded.state(c, rest)
            pressure, gas_stiffness = membrane.gas_pressure(state, rest.gas)
            u = self._basis @ c.T
            design_matrix = np.column_stack([np.ones(len(u)), self._X + u[:, :2]])
            gap = u[:, 2] - design_matrix @ plane
            touching = np.where(gap > 0, self._stiffness, 0.0)
            pressing = touching * gap
            load = -np.outer(normal, pressing @ self._basis)
            band = membrane.tangent(state, pressure)
            self._add(band, (self._basis.T * touching) @ self._basis, normal)
            stiffness = membrane.factorized(band, state, gas_stiffness)
            step = stiffness.solve(membrane.residual(state, pressure) - load)
            largest = float(np.abs(step).max())
            c = c - min(1.0, _STEP_MAX / max(largest, 1e-30)) * step
            if largest < _CONVERGED:
                moved = [
                    stiffness.solve(np.outer(normal, (touching * column) @ self._basis))
                    for column in design_matrix.T
                ]
                grown = [float((state.gradient * displacement).sum()) for displacement in moved]
                return _Equilibrium(
                    c, load, pressing, moved, pressure, -gas_stiffness * np.array(grown)
                )
        return None

    def _add(self, band: Array, products: Array, normal: Array) -> None:
        """Add the plane's stiffness to the membrane's `band`."""
        i, j = self._pairs
        values = products[i, j]
        for a in range(3):
            for b in range(3):
                row, column = 3 * i + a, 3 * j + b
                lower = row >= column
                entries = column[lower], row[lower] - column[lower]
                band[entries] += values[lower] * normal[a] * normal[b]

    def _traction(self, pressing: Array, normal: Array) -> Array:
        """Return the tractions (3, J), Pa, at the nodes of contact forces `pressing` (q,), N.
        Forces next to the frame are carried by the outermost nodes."""
        fractions = self._hats / self._hats.sum(axis=1, keepdims=True)
        return np.outer(-normal, pressing @ fractions / self._loaded.node_area)
