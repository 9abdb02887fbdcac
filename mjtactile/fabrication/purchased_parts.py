"""What a bench needs that the sensor file does not say: camera module, screws, fittings. Typical
parts. mm."""

from __future__ import annotations

from dataclasses import dataclass

PRINT_WALL = 1.2  # three lines of a 0.4 mm nozzle: the thinnest wall that is airtight and stiff
CLEARANCE = 0.3  # between printed parts that slide into each other
GASKET = 0.4  # silicone sheet of 0.5 mm, squeezed by a fifth
# thickness of clamping ring, of the glass seat behind the pane, of the mount's flange
RING = 3.0
SEAT = 3.0
FLANGE = 4.0
TUBE_WALL = 2.0  # of the camera mount
RECESS = 0.5  # of the bolts' heads behind the membrane, so that nothing but rubber stands in front
GLASS_HOLD = 2.0  # the least width on which the pane rests
GLASS_PLAY = 0.2  # of the pane in its seat, each side
# N/mm^2, allowable in bending of annealed glass under a lasting load (EN 16612 has 6 to 8)
GLASS_STRESS = 7.0
BOLT_SPACING = 34.0  # the farthest that keeps a printed ring of 3 mm tight
BOLT_LOAD = 100.0  # N, of one M2 or M3 in a printed part


@dataclass(frozen=True)
class Bolt:
    """A screw: clearance hole (ISO 273, medium), head (ISO 4762), nut (ISO 4032: across flats and
    height), radii and heights."""

    name: str
    radius: float
    hole: float
    head: float
    head_height: float
    nut: float
    nut_height: float
    lengths: tuple[int, ...] = (
        8,
        10,
        12,
        16,
        20,
        25,
        30,
        35,
        40,
        45,
        50,
        55,
        60,
        65,
        70,
        80,
        90,
        100,
        110,
        120,
    )


BOLTS = (Bolt("M3", 1.5, 1.7, 2.75, 3.0, 3.2, 2.4), Bolt("M2", 1.0, 1.2, 1.9, 2.0, 2.3, 1.6))


@dataclass(frozen=True)
class AirPort:
    """How air gets in: radius of the hole, least wall around it, what goes into it."""

    radius: float
    wall: float
    what: str
    bore: float  # of the hose that fits


PORTS = (
    AirPort(
        2.1,
        1.5,
        "barbed fitting M5 for a hose of 4 x 2.5 mm, M5 thread cut into the hole of 4.2 mm",
        2.5,
    ),
    AirPort(1.55, 1.3, "tube of 3 mm outer diameter, glued in, for a hose of 4 x 2.5 mm", 2.5),
    AirPort(
        1.05, 1.2, "steel tube of 2 mm outer diameter, glued in, for a hose of 3 x 1.5 mm", 1.5
    ),
)


@dataclass(frozen=True)
class Hardware:
    """The camera module and how it is used: `pixel` mm, `f_number` (None: the widest opening that
    is sharp enough), `holes` mm between its four M2 holes, `lens` diameter and `lens_front` mm from
    the entrance pupil to the front of the barrel, `pupil` mm from the board's front to the entrance
    pupil; `speed` mm/s of a marker that may smear by SMEAR px; `press` mm, the deepest (None: 4 mm,
    or a quarter of the chamber or of the frame's shorter side where these are less); `markers`
    "ink" or "discs"."""

    pixel: float = 0.003
    f_number: float | None = None
    holes: float = 28.0
    lens: float = 14.0
    lens_front: float = 4.0
    pupil: float = 12.0
    speed: float = 25.0
    press: float | None = None
    markers: str = "ink"


LED_BODY = (3.5, 2.8, 0.8)  # mm, the common 2835 package: length, width, height
# thickness of the ring's circuit board, and what it reaches beyond the LEDs, mm
LED_BOARD = 1.6
LED_EDGE = 1.25
LED_FLUX = 1.0  # W of light, the most of one LED in a short pulse
SPACER = 2.0  # under the camera board, mm
SMEAR = 0.05  # px of motion blur
FULL_WELL = 10_000  # electrons, of a pixel of 3 um
QUANTUM = 0.6  # electrons a photon, green light
"""Typical of small global-shutter sensors; the light that is asked for goes with 1 / (FULL_WELL
QUANTUM) only."""
