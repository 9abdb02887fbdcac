"""What body touches: each family fitted to the images of a touch, weighed by its evidence, and said
with what is not known (docs/equations.md, Eq. F18-F20)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from mjtactile.core.design import SensorDesign
from mjtactile.core.status import OK, Status, StatusCode
from mjtactile.core.types import SHAPES, Array, FeltShape, Touch
from mjtactile.sensing.body.families import FAMILIES, Family, Hint
from mjtactile.sensing.body.fit import Data, Fit, fit
from mjtactile.sensing.body.forward import Forward
from mjtactile.sensing.body.words import words
from mjtactile.sensing.force.inverse import InverseRest
from mjtactile.sensing.settings import DEFAULTS, Settings

_EDGE = 1.5e-3  # m from the frame, where bodies that go on are cut off
_INTERVAL = (0.16, 0.84)


@dataclass(frozen=True, eq=False)
class Weighed:
    """A family's fits to the images, the newest last (None: no film rests on it), and its
    probability."""

    family: Family
    fits: tuple[Fit | None, ...]
    probability: float


class ShapeFinder:
    """Finds what body touches one sensor; made once for a rest.

    Args:
        design: The sensor.
        rest: What it measured of itself with nothing touching.
        p_rest: (N, 3) m, its markers at rest in S.
        settings: Chosen numbers.
    """

    def __init__(
        self, design: SensorDesign, rest: InverseRest, p_rest: Array, settings: Settings = DEFAULTS
    ):
        self.settings = settings
        self._frame = np.array([design.frame.length, design.frame.width]) / 2 - _EDGE
        spacing = settings.body.spacing
        grid = tuple(
            max(round(side / spacing) + 1, 9) for side in (design.frame.length, design.frame.width)
        )
        self.forward = Forward(design, rest, p_rest, (grid[0], grid[1]))

    def find(self, touches: Sequence[Touch]) -> FeltShape:
        """Say what touches.

        Args:
            touches: Images of one press, oldest first; the newest is what is spoken of.

        Returns:
            The shape; "unknown", with a status, where it cannot be said.
        """
        s = self.settings.body
        newest = touches[-1]
        if newest.status != OK or newest.contact is None or newest.markers is None:
            return _unknown(Status(StatusCode.TOO_LITTLE_SEEN, f"no touch: {newest.status}"))
        if not newest.touching or newest.force_normal < s.force_least:
            return _unknown(Status(StatusCode.TOO_WEAK, f"less than {s.force_least:g} N"))
        chosen = self._chosen(touches)
        inverse = self.settings.inverse
        drift = (inverse.drift_gas, inverse.drift_camera)
        data = [Data.of(touch, self.forward.by_gas, s, drift) for touch in chosen]
        hints = [self._hint(touch) for touch in chosen]
        weighed = self._weigh([self._fits(family, hints, data) for family in FAMILIES.values()])
        best = max(weighed, key=lambda one: one.probability)
        newest_fit = best.fits[-1]
        if newest_fit is None:
            return _unknown(Status(StatusCode.NO_SHAPE, "no body of any family fits"))
        misfit = newest_fit.chi2 / len(data[-1].ids)
        probabilities = {
            kind: sum(one.probability for one in weighed if one.family.kind == kind)
            for kind in SHAPES
        }
        if misfit > s.misfit_most:
            text = f"no body explains the markers: misfit {misfit:.1f}, at most {s.misfit_most:g}"
            return _unknown(Status(StatusCode.NO_SHAPE, text), probabilities, misfit)
        kind = max(probabilities, key=lambda name: probabilities[name])
        mine = [one for one in weighed if one.family.kind == kind]
        spoken = max(mine, key=lambda one: one.probability).fits[-1]
        assert spoken is not None
        scale = max(1.0, misfit)
        return words(self.forward, spoken, probabilities, scale, self._interval(weighed, scale), s)

    def _chosen(self, touches: Sequence[Touch]) -> list[Touch]:
        """Images of the press that tell something, spread over its forces, the newest last."""
        s = self.settings.body
        newest = touches[-1]
        usable = [
            touch
            for touch in touches[:-1]
            if touch.touching
            and touch.status == OK
            and touch.contact is not None
            and touch.markers is not None
            and s.force_least < touch.force_normal
        ]
        if len(usable) >= s.images:
            order = sorted(usable, key=lambda touch: touch.force_normal)
            places = np.linspace(0, len(order) - 1, s.images + 1).round().astype(int)[1:-1]
            usable = [order[place] for place in sorted(set(places.tolist()))]
        return [*usable, newest]

    def _hint(self, touch: Touch) -> Hint:
        contact, surface = touch.contact, touch.surface
        assert contact is not None
        height = 0.0
        if surface is not None:
            column = int(np.abs(surface.x - contact.centroid[0]).argmin())
            row = int(np.abs(surface.y - contact.centroid[1]).argmin())
            height = float(surface.z[row, column])
        sheet = self.forward.film.design.membrane.thickness
        angle = contact.angle if math.isfinite(contact.angle) else 0.0
        return Hint(
            np.array(contact.centroid), height + sheet / 2, contact.area, angle, self._frame
        )

    def _fits(
        self, family: Family, hints: Sequence[Hint], data: Sequence[Data]
    ) -> tuple[Family, tuple[Fit | None, ...]]:
        """The family's bodies, one an image; the newest image is fitted first, others start from
        it."""
        newest = self._best(family, hints[-1], family.starts(hints[-1]), data[-1])
        if newest is None:
            return family, tuple(None for _ in data)
        earlier = [
            self._best(family, hint, (_moved(newest, hint),), one)
            for hint, one in zip(hints[:-1], data[:-1], strict=True)
        ]
        return family, (*earlier, newest)

    def _best(self, family: Family, hint: Hint, starts: Sequence[Array], data: Data) -> Fit | None:
        found = [fit(self.forward, family, hint, start, data) for start in starts]
        good = [one for one in found if one is not None]
        return max(good, key=lambda one: one.log_evidence, default=None)

    def _weigh(self, fitted: Sequence[tuple[Family, tuple[Fit | None, ...]]]) -> list[Weighed]:
        """Probabilities by evidence. What even the best family leaves of the markers is the film's
        and the simulator's doing: it is taken for noise, the same for all families."""
        images = len(fitted[0][1])
        logs = np.zeros(len(fitted))
        for image in range(images):
            fits = [row[1][image] for row in fitted]
            misfits = [one.chi2 / len(one.heights_off) for one in fits if one is not None]
            noise = max(1.0, min(misfits, default=1.0))
            logs += [
                -np.inf if one is None else one.log_evidence_with(noise) / math.sqrt(images)
                for one in fits
            ]
        top = logs.max()
        if not np.isfinite(top):
            share = np.full(len(fitted), 1 / len(fitted))
        else:
            share = np.exp(logs - top)
            share /= share.sum()
        return [
            Weighed(family, fits, float(p)) for (family, fits), p in zip(fitted, share, strict=True)
        ]

    def _interval(self, weighed: Sequence[Weighed], scale: float) -> tuple[float, float]:
        """68 % interval, m^2, of the area over all families."""
        parts = []
        for one in weighed:
            found = one.fits[-1]
            if found is not None and one.probability > 1e-3:
                area = found.state.area
                sd = math.hypot(found.area_sd * math.sqrt(scale), self.settings.body.area_sd * area)
                parts.append((one.probability, area, max(sd, 1e-9)))
        if not parts:
            return math.nan, math.nan
        p, area, sd = np.array(parts).T
        grid = np.linspace(
            max(0.0, float((area - 4 * sd).min())), float((area + 4 * sd).max()), 400
        )
        share = (p * ndtr((grid[:, None] - area) / sd)).sum(axis=1) / p.sum()
        low, high = np.interp(_INTERVAL, share, grid)
        return float(low), float(high)


def _moved(found: Fit, hint: Hint) -> Array:
    """The same body's numbers, counted from another hint; its height starts anew."""
    theta = found.theta.copy()
    theta[:2] += 1e3 * (found.hint.place - hint.place)
    return theta


def _unknown(
    status: Status, probabilities: dict[str, float] | None = None, misfit: float = math.nan
) -> FeltShape:
    return FeltShape(
        "unknown",
        dict.fromkeys(SHAPES, math.nan) if probabilities is None else probabilities,
        status=status,
        misfit=misfit,
    )
