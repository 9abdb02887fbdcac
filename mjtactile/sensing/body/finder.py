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
from mjtactile.sensing.body.families import FAMILIES, Family, Hint, kinds_of
from mjtactile.sensing.body.fit import Data, Fit, Prior, fit
from mjtactile.sensing.body.forward import Forward
from mjtactile.sensing.body.words import words
from mjtactile.sensing.force.inverse import InverseRest
from mjtactile.sensing.settings import DEFAULTS, BodySettings, Settings

_EDGE = 1.5e-3  # m from the frame, where bodies that go on are cut off
_LOST = 1e3  # of the log of evidence: a family of which no body can be there
_ROUNDING = 0.5  # spacings of the film
_INTERVAL = (0.16, 0.84)


@dataclass(frozen=True, eq=False)
class Weighed:
    """A family's body in the newest image (None: no film rests on it), its probability, and those
    of the kinds that it may be."""

    family: Family
    fit: Fit | None
    probability: float
    kinds: dict[str, float]


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
        film = self.forward.film
        x, y = np.meshgrid(film.x, film.y, indexing="ij")
        self._nodes = (x, y)

    def find(self, touches: Sequence[Touch]) -> FeltShape:
        """Say what touches.

        Args:
            touches: Images of one press, oldest first; the newest is what is spoken of.

        Returns:
            The shape; "unknown", with a status, where it cannot be said.
        """
        s = self.settings.body
        newest = touches[-1]
        lacking = told_nothing(newest, s)
        if lacking is not None:
            return lacking
        chosen = self._chosen(touches)
        inverse = self.settings.inverse
        drift = (inverse.drift_gas, inverse.drift_camera)
        data = [Data.of(touch, self.forward.by_gas, s, drift) for touch in chosen]
        hints = [self._hint(touch) for touch in chosen]
        weighed = self._follow(hints, data)
        likely = max(weighed, key=lambda one: one.probability).fit
        if likely is None:
            return _unknown(Status(StatusCode.NO_SHAPE, "no body of any family fits"))
        misfit = likely.misfit
        probabilities = {
            kind: sum(one.probability * one.kinds.get(kind, 0.0) for one in weighed)
            for kind in SHAPES
        }
        if misfit > s.misfit_most:
            text = f"no body explains the markers: misfit {misfit:.1f}, at most {s.misfit_most:g}"
            return _unknown(Status(StatusCode.NO_SHAPE, text), probabilities, misfit)
        kind = max(probabilities, key=lambda name: probabilities[name])
        spoken = max(weighed, key=lambda one: one.probability * one.kinds.get(kind, 0.0)).fit
        assert spoken is not None
        scale = max(s.noise_least, misfit)
        return words(
            self.forward, spoken, kind, probabilities, scale, self._interval(weighed, scale), s
        )

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
        film = self.forward.film
        spacing = float(film.x[1] - film.x[0])
        angle = contact.angle if math.isfinite(contact.angle) else 0.0
        return Hint(
            np.array(contact.centroid),
            height + sheet / 2,
            contact.area,
            angle,
            self._frame,
            self._nodes,
            _ROUNDING * spacing,
        )

    def _follow(self, hints: Sequence[Hint], data: Sequence[Data]) -> list[Weighed]:
        """Each family's body in the newest image, and its probability.

        Images are taken in their order: what one tells of a body is believed before the next, but
        for how deep it is pressed. What even the best family leaves of the markers is the film's
        and the simulator's doing: it is taken for noise, the same for all families.
        """
        families = list(FAMILIES.values())
        logs = np.zeros(len(families))
        fits: list[Fit | None] = [None] * len(families)
        noise = 1.0
        for hint, one in zip(hints, data, strict=True):
            now: list[Fit | None] = []
            known = math.inf
            for family, before in zip(families, fits, strict=True):
                found = self._best(family, hint, one, before, noise, known)
                known = known if found is None else min(known, found.chi2)
                now.append(found)
            noise = max(
                self.settings.body.noise_least,
                min((found.misfit for found in now if found), default=1.0),
            )
            logs += [found.log_evidence_with(noise) if found else -_LOST for found in now]
            fits = now
        share = np.exp(logs - logs.max())
        share /= share.sum()
        return [
            Weighed(
                family,
                found,
                float(p),
                kinds_of(family, found.theta, found.cov_with(noise)) if found else {},
            )
            for family, found, p in zip(families, fits, share, strict=True)
        ]

    def _best(
        self, family: Family, hint: Hint, data: Data, before: Fit | None, noise: float, known: float
    ) -> Fit | None:
        """The family's body, from its starts or from the image before."""
        if before is None:
            prior, starts = Prior.of(family), family.starts(hint)
        else:
            prior = before.then(noise, hint, family.loose)
            starts = (prior.mean * family.sd,)
        return fit(self.forward, family, hint, starts, data, prior, known)

    def _interval(self, weighed: Sequence[Weighed], scale: float) -> tuple[float, float]:
        """68 % interval, m^2, of the area over all families."""
        parts = []
        for one in weighed:
            found = one.fit
            if found is not None and one.probability > 1e-3:
                area = found.area
                sd = math.hypot(_area_sd(found, scale), self.settings.body.area_sd * area)
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


def told_nothing(touch: Touch, s: BodySettings) -> FeltShape | None:
    """An unknown shape where an image tells nothing of one; None where it does.

    Args:
        touch: The image's.
        s: Settings.

    Returns:
        The shape, or None.
    """
    if touch.status != OK or touch.contact is None or touch.markers is None:
        return _unknown(Status(StatusCode.TOO_LITTLE_SEEN, f"no touch: {touch.status}"))
    if not touch.touching or touch.force_normal < s.force_least:
        return _unknown(Status(StatusCode.TOO_WEAK, f"less than {s.force_least:g} N"))
    return None


def _area_sd(found: Fit, noise: float) -> float:
    """Of the contact's area, m^2, by the numbers' covariance."""
    by = found.gradients[:, 1]
    return math.sqrt(max(float(by @ found.cov_with(noise) @ by), 0.0))


def _unknown(
    status: Status, probabilities: dict[str, float] | None = None, misfit: float = math.nan
) -> FeltShape:
    return FeltShape(
        "unknown",
        dict.fromkeys(SHAPES, math.nan) if probabilities is None else probabilities,
        status=status,
        misfit=misfit,
    )
