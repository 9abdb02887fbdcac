"""Texts of an output folder: file list, checked values, bill of materials, and illustrated steps.

The files of `templates/` contain the text, with `{}` for values computed from the sensor file.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mjtactile.fabrication import purchased_parts as hw
from mjtactile.fabrication.camera_check import Optics, mirrored_in_image
from mjtactile.fabrication.housing_layout import Layout
from mjtactile.fabrication.layered_solid import Part
from mjtactile.fabrication.manufacturability import (
    MM,
    glass_stress,
    mount_tolerance,
    opening_margins,
)
from mjtactile.fabrication.marker_positions import MembraneState, growth
from mjtactile.fabrication.part_renderings import FRONT, SIDE
from mjtactile.fabrication.pressure_loads import PressureLoads
from mjtactile.fabrication.print_templates import board_of, page_size
from mjtactile.sim.sensor.validity_checks import STRETCHED

# force resolution required of the pressure sensor, N: a tenth of the paper's error
_FORCE_STEP = 0.004
_USB2 = 35e6  # byte/s that USB 2 really carries
_HOSE = 0.5  # hose length, m


@dataclass(frozen=True)
class ManualStep:
    """Step of the manual and its figure: an exploded view of `parts`, front to back, or a `cut`."""

    title: str
    text: str
    figure: str = ""
    parts: Sequence[str] = ()
    cut: bool = False

    @property
    def view(self) -> dict[str, Any]:
        return {"cut": True, "view": SIDE} if self.cut else {"view": FRONT}


def _template(name: str) -> str:
    return (Path(__file__).parent / "templates" / name).read_text(encoding="utf-8")


_ASSEMBLY = tomllib.loads(_template("assembly.toml"))
STEPS = tuple(ManualStep(**step) for step in _ASSEMBLY["step"])
FIDUCIALS = {surface: ManualStep(**step) for surface, step in _ASSEMBLY["fiducials"].items()}
"""Assembly step of a sensor with fiducials, by their surface; before the membrane is glued."""
RUBBER_SHEET = "rubber_sheet"
"""Stretched membrane on the jig; it appears only in the images."""


def steps_of(layout: Layout) -> tuple[ManualStep, ...]:
    """Return the assembly steps of this sensor."""
    fiducials = layout.design.fiducials
    if fiducials is None:
        return STEPS
    at = next(k for k, step in enumerate(STEPS) if step.figure == "stretch")
    return (*STEPS[:at], FIDUCIALS[fiducials.surface], *STEPS[at:])


def hose_volume(layout: Layout) -> float:
    """Return the volume of the hose and the port, mL."""
    return 1e6 * _HOSE * math.pi * (5e-4 * layout.port.bore) ** 2 + layout.volume_extra


def shore_a(young: float) -> float:
    """Return the Shore A hardness of rubber with Young's modulus `young`, Pa.

    Source: Gent, Rubber Chemistry and Technology 31, 1958.
    """
    k = 0.137505e-6 * young
    return (254 * k - 0.0981 * 56) / (0.0981 * 7.62336 + 2.54 * k)


def facts(layout: Layout, optics: Optics) -> dict[str, Any]:
    """Return the values used in the texts of the steps."""
    design = layout.design
    half = page_size(layout)
    seen = mirrored_in_image(design, optics.mirrors)
    first = optics.mirrors[0]
    ink = _ASSEMBLY["markers"][layout.hardware.markers]
    stretch = design.membrane.pre_stretch
    tolerance, stretch_error = mount_tolerance(design)
    mirrors = _ASSEMBLY["mirrors"]["some" if seen else "none"].format(
        seen=seen, count=len(optics.mirrors), u=first[0], v=first[1]
    )
    return {
        "layout": layout,
        "lip": 0.0 if layout.groove is None else -layout.groove[1],
        "spacer": hw.SPACER,
        "focus": optics.focus,
        "exposure": 1e6 * optics.exposure,
        "square": MM * board_of(design).square,
        "rubber_sheet": f"{2 * half[0]:.1f} x {2 * half[1]:.1f} mm",
        "ink": ink,
        "bolts": len(layout.bolts),
        "recess": hw.RECESS,
        "depth": MM * design.chamber.depth,
        "distance": MM * design.glass.distance,
        "supply": 1e-3 * design.chamber.supply_gauge,
        "hose": hose_volume(layout),
        "mirrors": mirrors,
        "tolerance": tolerance,
        "stretch_low": stretch - stretch_error,
        "stretch_high": stretch + stretch_error,
    }


def assembly(layout: Layout, optics: Optics, figures: Sequence[str]) -> str:
    """Return the text of `assembly.md`; `figures` are the available images."""
    known = facts(layout, optics)
    blocks = [
        f"# Assembly of {layout.design.name!r}",
        "Lengths in mm. +x is the side of the air port, the right side of the camera image.",
    ]
    for index, step in enumerate(steps_of(layout)):
        blocks.append(f"## {index}. {step.title}")
        if step.figure in figures:
            blocks.append(f"![{step.title}](pictures/{step.figure}.png)")
        blocks.append(step.text.format(**known))
    return "\n\n".join(blocks) + "\n"


_MARKERS = {
    True: (
        "marker colour",
        "thin against the sheet, elastic",
        "silicone or latex ink through the stencil",
    ),
    False: (
        "black discs",
        "stiff against the sheet",
        "discs cut from 0.025-0.05 mm polyester film, glued",
    ),
}
"""Marker, its kind and the product, of ink or of discs."""


def _valve_flow(conductance: float) -> str:
    if math.isinf(conductance):
        return "flow as high as possible"
    return f"{1e9 * conductance:g} mL/s at 1 kPa"


def bill(layout: Layout, optics: Optics, loads: PressureLoads) -> str:
    """Return the text of `bill.md`: the parts of one finger, and those needed once per gripper."""
    design = layout.design
    membrane = design.membrane
    half_x, half_y = page_size(layout)
    supply = 1e-3 * design.chamber.supply_gauge
    volume = 1e6 * design.chamber_volume_flat
    rate = design.camera.width * design.camera.height * design.camera.rate
    marker, marker_kind, marker_product = _MARKERS[layout.hardware.markers == "ink"]
    return _template("bill.md").format(
        layout=layout,
        design=design,
        optics=optics,
        sheet_x=2 * half_x,
        sheet_y=2 * half_y,
        thickness=MM * membrane.thickness,
        young=1e-6 * membrane.young,
        shore_a=shore_a(membrane.young),
        marker=marker,
        marker_kind=marker_kind,
        marker_product=marker_product,
        radius=MM * design.markers.radius,
        glass_x=2 * layout.glass_x,
        glass_y=2 * layout.glass_y,
        glass_z=MM * design.glass.thickness,
        outer_x=2 * layout.outer_x,
        outer_y=2 * layout.outer_y,
        bolts=len(layout.bolts),
        pixel=1e3 * layout.hardware.pixel,
        data_rate=1e-6 * rate,
        usb=2 if rate < _USB2 else 3,
        exposure=1e6 * optics.exposure,
        duty=100 * optics.exposure * design.camera.rate,
        hose_length=_HOSE,
        hose=hose_volume(layout),
        hose_percent=100 * hose_volume(layout) / volume,
        volume=volume,
        pump="pump" if supply >= 0 else "vacuum pump",
        pump_pressure=1e-3 * abs(loads.pump),
        pump_flow=max(volume / 1e3, 0.05),
        supply=supply,
        valve_flow=_valve_flow(design.chamber.valve_conductance),
        sensor_range=loads.sensor_range,
        highest=1e-3 * loads.highest.gauge_pressure,
        load=loads.highest.name,
        sensor_resolution=_FORCE_STEP / design.frame.area,
        force_step=1e3 * _FORCE_STEP,
    )


def readme(
    layout: Layout, parts: Mapping[str, Part], checks: Mapping[str, str], source: str
) -> str:
    """Return the text of `README.md`."""
    made = [part for part in parts.values() if part.make]
    sizes = {part.name: " x ".join(f"{s:.1f}" for s in part.size) for part in made}
    return _template("readme.md").format(
        layout=layout,
        source=source,
        parts="\n".join(
            f"| `{p.name}` | {sizes[p.name]} | {1e-3 * p.volume:.2f} | {p.description} |"
            for p in made
        ),
        checks="\n".join(f"| {check} | {value} |" for check, value in checks.items()),
        fiducials=""
        if layout.design.fiducials is None
        else "| [fiducials.pdf](fiducials.pdf), [fiducials.svg](fiducials.svg), "
        "[fiducials.dxf](fiducials.dxf) | fixed reference "
        "circles at 1:1 |\n",
    )


def _marker_size(layout: Layout, states: Sequence[MembraneState]) -> str:
    if layout.hardware.markers != "ink":
        return "discs keep their size"
    grown = growth(layout.design, states)
    seems = MM * grown * layout.design.camera.distance
    return (
        f"ink grows with the rubber, by up to {100 * grown:.1f} % (mean of all), and then "
        f"appears {seems:.2g} mm nearer; discs do not"
    )


def checks(
    layout: Layout,
    optics: Optics,
    press: float,
    states: Sequence[MembraneState],
    gap: float,
    loads: PressureLoads,
) -> dict[str, str]:
    """Return the checked values as readable text."""
    design = layout.design
    hardware = layout.hardware
    highest = max(abs(loads.highest.gauge_pressure), abs(design.chamber.supply_gauge))
    stretch = design.membrane.pre_stretch
    tolerance, stretch_error = mount_tolerance(design)
    simulated = (
        f"markers in the image, {len(states)} simulated states to {MM * press:.2g} mm of "
        f"indentation and {1e-3 * design.chamber.supply_gauge:g} kPa"
    )
    return {
        "rubber": (
            f"stretched up to {max(state.stretch for state in states):.2f} of its free length; "
            f"the simulated material law holds to {STRETCHED:g}"
        ),
        "markers' size": _marker_size(layout, states),
        "markers to the edge of the opening": f"at least {min(opening_margins(design)):.2f} mm",
        simulated: f"margin of {optics.margin:.0f} px ({optics.worst})",
        "sharpness": f"blur {optics.blur:.2f} px (sd) from {optics.near:.1f} to {optics.far:.1f} "
        f"mm at f/{optics.stop:g}; the sensor file allows {design.camera.blur_px:g}",
        "motion blur": f"{hw.SMEAR:g} px at {hardware.speed:g} mm/s with an exposure of "
        f"{1e6 * optics.exposure:.0f} us",
        "light": (
            f"{optics.flux:.2g} W from each of {design.leds.count} LEDs during the exposure; "
            f"photon noise {optics.noise:.1f} DN (sensor file: {design.camera.noise_dn:g})"
        ),
        "pressure": f"up to {1e-3 * highest:.2g} kPa ({loads.highest.name}): pressure sensor to "
        f"{loads.sensor_range:g} kPa, pump {1e-3 * abs(loads.pump):g} kPa",
        "mounted pre-stretch": f"{stretch - stretch_error:.3f} to {stretch + stretch_error:.3f} "
        f"with markers within {tolerance:.2f} mm of the mounted pattern",
        "glass": f"bending stress {glass_stress(design, highest):.2g} MPa of {hw.GLASS_STRESS:g} "
        "allowed",
        "bolts": f"{highest * design.frame.area / len(layout.bolts):.2g} N each of "
        f"{hw.BOLT_LOAD:g}",
        "parts": f"closed, without intersections, {gap:.2g} mm between parts that must not touch",
    }
