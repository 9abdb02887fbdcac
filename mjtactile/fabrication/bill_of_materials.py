"""Bill of materials with specifications computed from the sensor file.

It lists typical kinds of parts, without suppliers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mjtactile.fabrication.camera_check import Optics
from mjtactile.fabrication.housing_layout import Layout
from mjtactile.fabrication.manufacturability import MM
from mjtactile.fabrication.print_templates import page_size

_FORCE = 2.5  # largest force in the paper's measurements, N
# force resolution required of the pressure sensor, N: a tenth of the paper's error
_FORCE_STEP = 0.004
_PINION = 0.010  # pinion radius, m
_USB2 = 35e6  # byte/s that USB 2 really carries
_HOSE = 0.5  # hose length, m


@dataclass(frozen=True)
class Item:
    """One line: part, count, required specification and typical product."""

    what: str
    count: str
    wanted: str
    typical: str


def shore_a(young: float) -> float:
    """Hardness Shore A of rubber with Young's modulus `young` Pa (Gent, Rubber Chemistry and
    Technology 31, 1958)."""
    k = 0.137505e-6 * young
    return (254 * k - 0.0981 * 56) / (0.0981 * 7.62336 + 2.54 * k)


def hose_volume(layout: Layout) -> float:
    """mL in half a metre of hose and the port."""
    return 1e6 * _HOSE * math.pi * (5e-4 * layout.port.bore) ** 2 + layout.volume_extra


def bill(layout: Layout, optics: Optics) -> list[Item]:
    """Return the bill of one finger, plus the parts needed once per gripper."""
    return [*_mechanics(layout), *_seeing(layout, optics), *_air(layout), *_driving()]


def _mechanics(layout: Layout) -> list[Item]:
    design = layout.design
    bolt = layout.bolt
    count = len(layout.bolts)
    sheet = design.membrane
    half_x, half_y = page_size(layout)
    ink = layout.hardware.markers == "ink"
    return [
        Item(
            "white rubber sheet",
            "1",
            f"{2 * half_x:.0f} x {2 * half_y:.0f} mm, {MM * sheet.thickness:g} mm thick, E = "
            f"{1e-6 * sheet.young:g} MPa (about Shore A {shore_a(sheet.young):.0f}), opaque",
            "silicone or latex sheet",
        ),
        Item(
            "marker colour" if ink else "black discs",
            f"{design.markers.count} markers",
            f"radius {MM * design.markers.radius:g} mm mounted, matte black, "
            f"{'thin against the sheet, elastic' if ink else 'stiff against the sheet'}",
            "silicone or latex ink through the stencil"
            if ink
            else "discs cut from 0.025-0.05 mm polyester film, glued",
        ),
        Item(
            "glass pane",
            "1",
            f"{2 * layout.glass_x:.2f} x {2 * layout.glass_y:.2f} x "
            f"{MM * design.glass.thickness:g} mm, n = {design.glass.refractive_index:g}, edges "
            "ground",
            "float glass, anti-reflection coated if available",
        ),
        Item(
            "gasket",
            "1",
            f"silicone sheet 0.5 mm, {2 * layout.outer_x:.0f} x {2 * layout.outer_y:.0f} mm",
            "cut along gasket.svg",
        ),
        Item(
            f"bolts {bolt.name} x {layout.bolt_length}",
            str(count),
            "socket head, with washer and nut",
            "ISO 4762, ISO 7089, ISO 4032",
        ),
        Item("screws M2 x 8, spacers M2 x 2 mm", "4", "for the camera board", "ISO 4762"),
        Item(
            "adhesive",
            "1",
            "bonds to the rubber, stays soft",
            "silicone adhesive (silicone), rubber cement (latex)",
        ),
    ]


def _seeing(layout: Layout, optics: Optics) -> list[Item]:
    design = layout.design
    hardware = layout.hardware
    camera = design.camera
    rate = design.camera.width * design.camera.height * design.camera.rate
    x, y, across = optics.fov
    return [
        Item(
            "camera module",
            "1",
            f"monochrome, global shutter, {camera.width} x {camera.height} px of "
            f"{1e3 * hardware.pixel:g} um, at least {camera.rate:g} Hz at 8 bit ({1e-6 * rate:.0f} "
            f"MB/s), exposure fixed at {1e6 * optics.exposure:.0f} us or less, strobe output; "
            f"holes {hardware.holes:g} x {hardware.holes:g} mm",
            f"UVC board camera, USB {2 if rate < _USB2 else 3}",
        ),
        Item(
            "lens",
            "1",
            f"f = {optics.focal:.2f} mm, f/{optics.stop:g}, field of view {x:.0f} x {y:.0f} "
            f"deg ({across:.0f} deg diagonal), sharp from {optics.near:.1f} to "
            f"{optics.far:.1f} mm, focused at {optics.focus:.1f} mm and locked",
            "M12",
        ),
        Item(
            "LEDs",
            str(design.leds.count),
            f"white, 120 deg, {optics.flux:.2g} W of light each during the exposure "
            f"({100 * optics.exposure * camera.rate:.2g} % of the time)",
            "2835 package, pulsed by the camera's strobe output",
        ),
        Item(
            "linear polarizing film",
            "2",
            "crossed: one on the LED ring, one on the lens; removes the LEDs' reflections in "
            "the glass",
            "film",
        ),
    ]


def _air(layout: Layout) -> list[Item]:
    design = layout.design
    chamber = design.chamber
    volume = 1e6 * design.chamber_volume_flat
    supply = 1e-3 * chamber.supply_gauge
    if math.isinf(chamber.valve_conductance):
        flow = "flow as high as possible"
    else:
        flow = f"{1e9 * chamber.valve_conductance:g} mL/s at 1 kPa"
    resolution = _FORCE_STEP / design.frame.area
    return [
        Item("air port", "1", layout.port.what, "brass or steel"),
        Item(
            "hose",
            f"{_HOSE:g} m",
            f"{layout.port.bore:g} mm bore, stiff, as short as possible: it holds "
            f"{hose_volume(layout):.2f} mL with the port, "
            f"{100 * hose_volume(layout) / volume:.0f} % of the chamber's {volume:.1f} mL: "
            "write it into chamber.extra_volume_mL",
            "polyurethane",
        ),
        Item(
            "pump" if supply >= 0 else "vacuum pump",
            "1 a gripper",
            f"{abs(supply):g} kPa plus 50 %, {max(volume / 1e3, 0.05):.2g} L/min, with a "
            "reservoir and a relief valve",
            "12 V diaphragm pump",
        ),
        Item(
            "valve",
            "1",
            f"{supply:g} kPa, leak below 0.1 mL/min, {flow}; opens without power, so that a "
            "failed board vents",
            "3/2 solenoid valve, or a proportional one",
        ),
        Item(
            "pressure sensor",
            "1",
            f"gauge pressure, 0 to {max(2 * abs(supply), 2):g} kPa, resolution "
            f"{resolution:.2g} Pa ({1e3 * _FORCE_STEP:g} mN on the whole membrane), stable "
            "zero, in a T-piece behind the valve",
            "I2C, temperature-compensated",
        ),
    ]


def _driving() -> list[Item]:
    torque = _FORCE * _PINION
    return [
        Item(
            "servo",
            "1 per gripper or finger",
            f"current-based position mode, {2 * torque:.2g} N m at a pinion of "
            f"{MM * _PINION:g} mm ({_FORCE:g} N, the paper's range, twice)",
            "XL330-M288-T or XM430-W350-T, see docs/how-to/hardware.md",
        ),
        Item(
            "USB adapters",
            "1 + 1 a gripper",
            "half-duplex TTL at 1 Mbaud for the servos, latency timer 1 ms; serial port for "
            "the valve board",
            "U2D2 or similar; that of the board",
        ),
    ]


def table(items: list[Item]) -> str:
    """As Markdown."""
    rows = [f"| {i.what} | {i.count} | {i.wanted} | {i.typical} |" for i in items]
    return "\n".join(
        ["| part | count | requirement | typical product |", "|---|---|---|---|", *rows]
    )
