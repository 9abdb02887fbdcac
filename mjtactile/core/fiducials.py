"""Fixed reference circles: the `[fiducials]` section of a sensor file, and positions.

Straight chamber walls hide the inner face of the frame from the camera. The walls are therefore set
back for circles on the rim. The rim then forms a lip, `lip` thick and `step` wide. The circles are
on its inner face. Their distance, sharpness and illumination equal those of the membrane's markers.
Circles on the glass's inner face need no setback. They are closer and out of focus. They lie in the
image strip outside the opening.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from mjtactile.core.config_fields import MM, entry, number, text
from mjtactile.core.field_types import Pairs
from mjtactile.core.toml import Section
from mjtactile.core.types import Array

SensorDesign: TypeAlias = Any  # `mjtactile.core.design` imports this module

SURFACES = ("rim", "glass")
COUNT_MIN = 4
"""Minimum number of fiducials for a camera's position, rotation and scale, plus one spare."""
_COUNT_MAX = 64
_WALL = 0.5e-3  # wall thickness that must remain behind the step, m
_INK = 5e-6  # thickness of a print on the glass, m
_BORDER_PX = 6.0  # margin between a circle's edge and the image border, needed for its fit


@dataclass(frozen=True)
class Fiducials:
    """Fixed black circles on white ground, lengths in m; see the module.

    Attributes:
        surface: "rim" or "glass".
        radius: Radius of each circle.
        places: Centers (x, y) in S.
        ground: Width of the white area around each circle.
        lip: Thickness of the rim in front of the circles; only for "rim".
        step: Setback of the walls behind the lip; only for "rim".
        blur_px: Standard deviation of the image blur there; only for the glass, which is out of
            focus.
    """

    surface: str = text("surface", SURFACES, about="surface that carries the circles")
    radius: float = number("radius_mm", 0.05, 50, MM, about="radius of each black circle")
    places: tuple[tuple[float, float], ...] = entry(
        Pairs(key="positions_mm", units=(MM, MM), about="center [x, y] of each circle")
    )
    ground: float = number(
        "quiet_zone_mm", 0.05, 50, MM, default=0.5e-3, about="white ring around each circle, 8 px"
    )
    lip: float = number(
        "lip_mm",
        0.2,
        20,
        MM,
        default=1e-3,
        about="thickness of the rim in front of the circles",
        only_if=("surface", ("rim",)),
    )
    step: float = number(
        "wall_setback_mm",
        0.5,
        50,
        MM,
        default=3.2e-3,
        about="setback of the walls behind the lip",
        only_if=("surface", ("rim",)),
    )
    blur_px: float = number(
        "blur_px",
        0,
        20,
        default=2.0,
        about="sd of the image blur at the circles",
        only_if=("surface", ("glass",)),
    )

    @property
    def count(self) -> int:
        """Number of circles, F."""
        return len(self.places)

    def p_SF(self, design: SensorDesign) -> Array:
        """Return the centers (F, 3), m, in S."""
        z = -self.lip if self.surface == "rim" else _INK - design.chamber.depth
        return np.array([(x, y, z) for x, y in self.places])

    def groove(self, design: SensorDesign) -> float:
        """Return the height of the space behind the lip, m; 0 on the glass.

        It is the extent of the camera's lines of sight to the circles beyond the opening's edge.
        """
        if self.surface != "rim":
            return 0.0
        frame = design.frame
        extent = self.radius + self.ground
        if frame.outline is None:
            half = np.array([frame.length, frame.width]) / 2
            outside = np.abs(self.places) + extent
            past = np.where(outside > half, half / outside, 1.0).min()
        else:
            xy = np.array(self.places)
            far = np.linalg.norm(xy, axis=1)
            past = np.minimum((far + frame.inside(xy)) / (far + extent), 1.0).min()
        behind = (1 - float(past)) * (design.camera.distance - self.lip)
        return min(behind, design.chamber.depth - self.lip)

    def volume(self, design: SensorDesign) -> float:
        """Compute the gas volume that the groove adds to the chamber, m^3."""
        if self.surface != "rim":
            return 0.0
        frame = design.frame
        outside = (frame.length + 2 * self.step) * (frame.width + 2 * self.step)
        corners = (4 - math.pi) * self.step**2  # as far from the opening's as the walls are
        around = outside - corners - frame.area
        if frame.outline is not None:  # Steiner's formula for a convex outline
            around = frame.outline.length * self.step + math.pi * self.step**2
        return around * self.groove(design)

    def check(self, design: SensorDesign, section: Section) -> None:
        """Raise InputError unless the circles are on their surface, separate, and visible in
        `design`."""
        if not COUNT_MIN <= self.count <= _COUNT_MAX:
            message = f"has {self.count} circles; {COUNT_MIN} to {_COUNT_MAX} are allowed"
            raise section.fail("fiducials.positions_mm", message)
        if self.surface == "rim" and self.step + _WALL > design.frame.rim:
            message = (
                f"{self.step / MM:g} leaves no wall at frame.wall_mm = {design.frame.rim / MM:g}"
            )
            raise section.fail("fiducials.wall_setback_mm", message)
        if self.surface == "rim" and self.lip >= design.chamber.depth:
            message = f"{self.lip / MM:g} is not less than the chamber depth"
            raise section.fail("fiducials.lip_mm", message)
        xy = np.array(self.places)
        distances = np.linalg.norm(xy[:, None] - xy, axis=2) + np.diag(np.full(len(xy), np.inf))
        if distances.min() < 2 * self.radius + self.ground:
            message = (
                f"circles {distances.min() / MM:.3g} mm apart leave no white ground between them"
            )
            raise section.fail("fiducials.positions_mm", message)
        for circle, why in zip(self.places, self._position_errors(design), strict=True):
            if why:
                message = f"[{circle[0] / MM:g}, {circle[1] / MM:g}] {why}"
                raise section.fail("fiducials.positions_mm", message)

    def _position_errors(self, design: SensorDesign) -> list[str]:
        """Return the error of each position; "" if it is valid."""
        half = np.array([design.frame.length, design.frame.width]) / 2
        extent = self.radius + self.ground
        xy = np.abs(self.places)
        # at the opening, along the camera's line of sight past them
        depth = design.camera.distance - design.apparent_glass_thickness
        here = depth + self.p_SF(design)[:, 2]
        grows = np.ones(len(xy)) if self.surface == "rim" else depth / here
        if design.frame.outline is None:
            observed = (xy - extent) * grows[:, None]
            hides = (observed < half).all(axis=1)
            beyond = (xy + extent > half + self.step).any(axis=1)
        else:
            hides = design.frame.inside(grows[:, None] * self.places) > -extent * grows
            beyond = design.frame.inside(np.array(self.places)) < extent - self.step
        beyond = beyond & (self.surface == "rim")
        out = self._outside_image(design, xy, here)
        words = {
            "rim": "is not on the lip with its whole quiet zone",
            "glass": "hides part of the membrane",
        }
        found = np.where(out, "is outside the image", "")
        found = np.where(beyond, words["rim"], found)
        return np.where(hides, words[self.surface], found).tolist()

    def _outside_image(self, design: SensorDesign, xy: Array, depth: Array) -> Array:
        """Return the mask (F,) of circles that extend to or beyond the image border. `depth` (F,)
        accounts for the glass."""
        camera = design.camera
        far = camera.lens.distort((xy + self.radius) / depth[:, None]) * [camera.fx, camera.fy]
        room_u = min(camera.cx, camera.width - 1 - camera.cx)
        room_v = min(camera.cy, camera.height - 1 - camera.cy)
        return (far > np.array([room_u, room_v]) - _BORDER_PX).any(axis=1)
