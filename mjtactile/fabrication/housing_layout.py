"""`Layout`: all dimensions of the housing from the sensor file and the hardware, mm, frame S.

From the front, the membrane at z = 0 over the rim comes first. The clamping ring, frame and gasket
follow. Behind them are the glass in its seat, and the mount with LED ring and camera. One set of
bolts passes through all parts. The mount's tube lies inside of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from mjtactile.core.design import SensorDesign
from mjtactile.core.sensor_parts import FrameShape
from mjtactile.fabrication import purchased_parts as hw
from mjtactile.fabrication.manufacturability import MM, Limit, check_all, limits_of
from mjtactile.fabrication.purchased_parts import BOLTS, PORTS, AirPort, Bolt, Hardware

_FLAT = 0.5  # wall width next to the port's bore, mm
_SMALL = 25.0  # mm: openings below it get the smaller bolts


@dataclass(frozen=True)
class Layout:
    """Half sizes `*_x`, `*_y` and heights `z_*`, mm. `of` also checks that it can be built."""

    design: SensorDesign
    hardware: Hardware

    @classmethod
    def of(cls, design: SensorDesign, hardware: Hardware, source: str) -> Layout:
        """Compute the layout. Raises InputError for a value that cannot be built."""
        check_all(limits_of(design, hardware), source)
        layout = cls(design, hardware)
        check_all(layout.limits(), source)
        return layout

    def limits(self) -> Iterator[Limit]:
        """Return the limits that depend on the computed layout."""
        chamber = self.design.chamber
        near = MM * self.design.glass.distance
        need = 2 * (PORTS[-1].radius + PORTS[-1].wall)
        yield Limit(
            "chamber.depth_mm",
            MM * chamber.depth,
            "leaves too little wall for the air port",
            MM * chamber.depth - self.wall + need,
        )
        yield Limit(
            "glass.distance_mm",
            near,
            "leaves no room for the nuts between the mount's flange and the camera's plate",
            near + self.z_plate + 0.5 - (self.z_ring[1] - self.bolt_length),
        )
        yield Limit(
            "chamber.supply_pressure_kPa",
            1e-3 * abs(chamber.supply_gauge),
            f"loads each of {len(self.bolts)} bolts with more than {hw.BOLT_LOAD:g} N",
            high=1e-3 * hw.BOLT_LOAD * len(self.bolts) / self.design.frame.area,
        )

    @property
    def is_traced(self) -> bool:
        """True if the opening is modeled as a polygon of many corners."""
        return self.design.frame.shape not in (FrameShape.RECTANGLE, FrameShape.ROUNDED)

    @property
    def flat(self) -> float:
        """Half the width of the chamber's straight wall on the +x side, for the port."""
        return self.port.radius + _FLAT

    @property
    def open_x(self) -> float:
        return MM * self.design.frame.length / 2

    @property
    def open_y(self) -> float:
        return MM * self.design.frame.width / 2

    @property
    def rim(self) -> float:
        return MM * self.design.frame.rim

    @property
    def rubber_thickness(self) -> float:
        """Thickness of the rubber."""
        return MM * self.design.membrane.thickness

    @property
    def bolt(self) -> Bolt:
        return BOLTS[0] if 2 * min(self.open_x, self.open_y) >= _SMALL else BOLTS[1]

    @property
    def wall(self) -> float:
        """Height of the frame's wall behind its flange."""
        return self.z_flange - self.z_block

    @property
    def port(self) -> AirPort:
        """The largest that fits into the wall."""
        fitting = (port for port in PORTS if self.wall >= 2 * (port.radius + port.wall))
        return next(fitting, PORTS[-1])

    @property
    def ring(self) -> float:
        """From the opening to the clamping ring, which leaves room for rim and rubber."""
        return self.rim + self.rubber_thickness + hw.CLEARANCE

    @property
    def groove(self) -> tuple[float, float, float] | None:
        """Lowest and highest height of the fiducials' groove, and the setback of its walls."""
        fiducials = self.design.fiducials
        if fiducials is None or fiducials.surface != "rim":
            return None
        lip = MM * fiducials.lip
        return -lip - MM * fiducials.groove(self.design), -lip, MM * fiducials.step

    @property
    def hold(self) -> float:
        """Width of the glass support on the frame."""
        return min(max(self.rim, hw.GLASS_HOLD), 2 * hw.GLASS_HOLD)

    @property
    def glass_x(self) -> float:
        return self.open_x + self.hold

    @property
    def glass_y(self) -> float:
        return self.open_y + self.hold

    @property
    def led_inner(self) -> float:
        lens = self.hardware.lens / 2 + 0.5
        return max(lens, MM * self.design.leds.ring_radius - hw.LED_BODY[0] / 2 - hw.LED_EDGE)

    @property
    def led_outer(self) -> float:
        return MM * self.design.leds.ring_radius + hw.LED_BODY[0] / 2 + hw.LED_EDGE

    @property
    def tube_x(self) -> float:
        """Inside of the mount's tube."""
        return self._tube(self.open_x)

    @property
    def tube_y(self) -> float:
        return self._tube(self.open_y)

    def _tube(self, half: float) -> float:
        return _clear_of(
            self.hardware.holes / 2, max(half + self.hold - hw.GLASS_HOLD, self.led_outer + 0.5)
        )

    @property
    def line_x(self) -> float:
        """Position of the bolts: outside of the clamping ring, the glass seat and the tube."""
        return self._line(self.open_x, self.tube_x)

    @property
    def line_y(self) -> float:
        return self._line(self.open_y, self.tube_y)

    def _line(self, half: float, tube: float) -> float:
        seat = half + self.hold + hw.GLASS_PLAY + hw.PRINT_WALL
        return max(
            half + self.ring + self.bolt.head + 0.5,
            seat + self.bolt.hole,
            tube + hw.TUBE_WALL + self.bolt.nut + 0.3,
        )

    @property
    def outer_x(self) -> float:
        """Outside of all that is bolted together."""
        return self.line_x + self.bolt.head + 1

    @property
    def outer_y(self) -> float:
        return self.line_y + self.bolt.head + 1

    @property
    def z_flange(self) -> float:
        """Frame surface under the clamping ring."""
        return -(hw.RING + self.rubber_thickness + self.bolt.head_height + hw.RECESS)

    @property
    def z_glass(self) -> float:
        """Front of the glass."""
        return -MM * self.design.chamber.depth

    @property
    def z_block(self) -> float:
        """Back of the frame."""
        return self.z_glass + hw.GASKET

    @property
    def z_glass_plane(self) -> float:
        """Back of the glass."""
        return self.z_glass - MM * self.design.glass.thickness

    @property
    def z_seat(self) -> float:
        """Back of the glass seat."""
        return self.z_glass_plane - hw.SEAT

    @property
    def z_mount(self) -> float:
        """Back of the mount's flange."""
        return self.z_seat - hw.FLANGE

    @property
    def z_camera(self) -> float:
        """Center of the camera, and faces of the LEDs."""
        return -MM * self.design.camera.distance

    @property
    def z_leds(self) -> float:
        """Front of the LED circuit board."""
        return self.z_camera - hw.LED_BODY[2]

    @property
    def z_plate(self) -> float:
        """Front of the mount's back plate."""
        return self.z_leds - hw.LED_BOARD

    @property
    def z_back(self) -> float:
        """Back of the mount's back plate."""
        return self.z_camera - self.hardware.pupil + hw.SPACER

    @property
    def bolts(self) -> list[tuple[float, float]]:
        """Positions of the bolts around the frame; none at y = 0, where the air enters from +x."""
        across, along = (
            math.ceil(2 * line / hw.BOLT_SPACING) for line in (self.line_x, self.line_y)
        )
        along += 1 - along % 2
        xs = [self.line_x * (2 * k / across - 1) for k in range(across + 1)]
        ys = [self.line_y * (2 * k / along - 1) for k in range(1, along)]
        return [(x, s * self.line_y) for s in (-1, 1) for x in xs] + [
            (s * self.line_x, y) for s in (-1, 1) for y in ys
        ]

    @property
    def z_port(self) -> float:
        return (self.z_flange + self.z_block) / 2

    @property
    def z_ring(self) -> tuple[float, float]:
        """Heights of the clamping ring."""
        return (
            self.z_flange + self.rubber_thickness,
            self.z_flange + self.rubber_thickness + hw.RING,
        )

    @property
    def bolt_length(self) -> int:
        """The shortest standard bolt that reaches through everything, a washer and its nut."""
        need = self.z_ring[1] - self.z_mount + 0.5 + self.bolt.nut_height
        return next((length for length in self.bolt.lengths if length >= need), math.ceil(need))

    @property
    def plate_x(self) -> float:
        """Half width of the mount's back plate, which carries the camera and a gripper's jaw."""
        return max(self.tube_x + hw.TUBE_WALL, self.hardware.holes / 2 + 3) + 8

    @property
    def plate_y(self) -> float:
        return max(self.tube_y + 4, self.hardware.holes / 2 + 3)

    @property
    def opening_view(self) -> tuple[float, float]:
        """Half sizes of the window in the glass seat."""
        return self.glass_x - hw.GLASS_HOLD, self.glass_y - hw.GLASS_HOLD

    @property
    def volume_extra(self) -> float:
        """Gas in the port, mL, that the chamber's depth does not count."""
        return 1e-3 * math.pi * self.port.radius**2 * (self.outer_x - self.open_x)


def _clear_of(holes: float, tube: float) -> float:
    """Return the half size of a tube, at least `tube`, whose wall avoids the camera's screws,
    mm."""
    clear = 1.6
    if holes - clear - hw.TUBE_WALL < tube < holes + clear:
        return holes + clear
    return tube
