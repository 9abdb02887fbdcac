"""Typical purchased parts that the sensor file does not define; lengths in mm."""

from __future__ import annotations

from dataclasses import dataclass

PRINT_WALL = 1.2  # three lines of a 0.4 mm nozzle: the thinnest wall that is airtight and stiff
CLEARANCE = 0.3  # between printed parts that slide into each other
GASKET = 0.4  # silicone sheet of 0.5 mm, compressed by a fifth
RING = 3.0  # thickness of the clamping ring
SEAT = 3.0  # thickness of the glass seat
FLANGE = 4.0  # thickness of the mount's flange
TUBE_WALL = 2.0  # wall of the camera mount's tube
RECESS = 0.5  # depth of the bolts' heads behind the membrane, so that only rubber is in front
GLASS_HOLD = 2.0  # minimum width of the glass support
GLASS_PLAY = 0.2  # clearance of the glass in its seat, each side
# allowable bending stress of annealed glass under a lasting load, N/mm^2 (EN 16612 has 6 to 8)
GLASS_STRESS = 7.0
BOLT_SPACING = 34.0  # maximum bolt distance that keeps a printed ring of 3 mm tight
BOLT_LOAD = 100.0  # load of one M2 or M3 bolt in a printed part, N


@dataclass(frozen=True)
class Bolt:
    """Radii and heights of a screw's clearance hole (ISO 273), head (ISO 4762), nut (ISO 4032)."""

    name: str
    radius: float
    hole: float
    head: float
    head_height: float
    nut: float
    nut_height: float
    lengths: tuple[int, ...] = (8, 10, 12, 16, *range(20, 70, 5), *range(70, 130, 10))


BOLTS = (Bolt("M3", 1.5, 1.7, 2.75, 3.0, 3.2, 2.4), Bolt("M2", 1.0, 1.2, 1.9, 2.0, 2.3, 1.6))


@dataclass(frozen=True)
class AirPort:
    """Air inlet: radius of the hole, minimum wall around it, fitting, and hose bore."""

    radius: float
    wall: float
    description: str
    bore: float  # inner diameter of the hose


_FITTING = "barbed fitting M5 for a hose of 4 x 2.5 mm, M5 thread cut into the hole of 4.2 mm"
_TUBE = "tube of 3 mm outer diameter, glued in, for a hose of 4 x 2.5 mm"
_STEEL_TUBE = "steel tube of 2 mm outer diameter, glued in, for a hose of 3 x 1.5 mm"
PORTS = (
    AirPort(2.1, 1.5, _FITTING, 2.5),
    AirPort(1.55, 1.3, _TUBE, 2.5),
    AirPort(1.05, 1.2, _STEEL_TUBE, 1.5),
)


@dataclass(frozen=True)
class Hardware:
    """Camera module and its use.

    `pixel`: pixel size, mm. `f_number` (None: the widest aperture that is sharp enough). `holes`:
    distance of its four M2 holes, mm. `lens`: its diameter, mm. `lens_front`: distance from the
    entrance pupil to the front of the barrel, mm. `pupil`: distance from the board's front to the
    entrance pupil, mm. `speed`: speed of a marker with a smear of SMEAR px, mm/s. `press`: largest
    indentation, mm. None is 4 mm, but at most a quarter of the chamber and of the frame's shorter
    side. `markers`: "ink" or "discs".
    """

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
LED_BOARD = 1.6  # thickness of the ring's circuit board
LED_EDGE = 1.25  # its overhang beyond the LEDs
LED_FLUX = 1.0  # maximum light of one LED in a short pulse, W
SPACER = 2.0  # under the camera board, mm
SMEAR = 0.05  # px of motion blur
FULL_WELL = 10_000  # full-well capacity of a pixel of 3 um, electrons
QUANTUM = 0.6  # electrons per photon, green light; typical of small global-shutter sensors
