"""`README.md` and `assembly.md` of an output folder: file list, checked values, and illustrated
steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mjtactile.fabrication import purchased_parts as hw
from mjtactile.fabrication.bill_of_materials import hose_volume
from mjtactile.fabrication.camera_check import Optics, mirrored_in_image
from mjtactile.fabrication.housing_layout import Layout
from mjtactile.fabrication.layered_solid import Part
from mjtactile.fabrication.manufacturability import MM, glass_stress, opening_margins
from mjtactile.fabrication.marker_positions import MembraneState, growth
from mjtactile.fabrication.part_renderings import FRONT, SIDE
from mjtactile.fabrication.print_templates import board_of, page_size
from mjtactile.sim.sensor.validity_checks import STRETCHED


@dataclass(frozen=True)
class ManualStep:
    """Step of the manual and its figure.

    `parts` lists the names from front to back. The figure is an exploded view, unless it is a
    `cut`. `{}` in the text are `facts`.
    """

    title: str
    picture: str
    parts: tuple[str, ...]
    text: str
    cut: bool = False

    @property
    def view(self) -> dict[str, Any]:
        return {"cut": True, "view": SIDE} if self.cut else {"view": FRONT}


STEPS = (
    ManualStep(
        "All parts",
        "exploded",
        (
            "bolts",
            "clamp_ring",
            "membrane",
            "frame",
            "gasket",
            "glass",
            "glass_seat",
            "led_ring",
            "camera_mount",
            "nuts",
            "camera",
        ),
        "From the front (left) to the back. Make the frame, clamping ring, glass seat, "
        "camera mount and stretching jig from `cad/`; buy the other parts "
        "([bill.md](bill.md)). Print the parts in PETG, ABS or resin with at least four "
        "perimeters, so that they are airtight, or have them milled. Break the outer edges "
        "of the frame's rim by 0.5 mm and polish them: the rubber lies on them.",
    ),
    ManualStep(
        "Camera and light",
        "camera",
        ("led_ring", "camera_mount", "camera"),
        "Solder the LED ring after [led_ring.svg](led_ring.svg). Glue it into the mount with "
        "the LEDs to the front and the wires through the small hole on the +x side. Screw "
        "the camera on from behind with {spacer:g} mm spacers, the lens through the large "
        "hole, the right side of the image to +x (the side of the air port). The LED faces "
        "must be in the plane of the lens pupil, {pupil:g} mm in front of the camera board. "
        "Focus on {focus:.1f} mm from the pupil and lock the lens. Set the exposure to "
        "{exposure:.0f} us and fix gain and white balance. Print [board.pdf](board.pdf), "
        "glue it to a flat plate, and calibrate before the glass is mounted:\n"
        "\n"
        "    mjtactile calibrate camera --rig my_gripper.toml --finger left --square-mm "
        "{square:g}",
    ),
    ManualStep(
        "Markers on the rubber",
        "print",
        (),
        "Measure the scale bars of [markers.pdf](markers.pdf) in both directions: {bar}. Cut "
        "the rubber to {sheet}. Lay it flat, **not stretched**. {ink} Punch the holes for "
        "the pegs (crosses along the edge, 2.5 mm).",
    ),
    ManualStep(
        "Stretch",
        "stretch",
        ("sheet", "stretch_jig"),
        "Hang the rubber on the pegs of the jig, markers down. The jig stretches it by "
        "{stretch:g} in both directions; the center stays in place, and circles stay "
        "circles. Print page 3 of [markers.pdf](markers.pdf) on transparency film and lay it "
        "on the rubber: markers must match within 0.3 mm. Where one side is off, move the "
        "holes of its pegs.",
    ),
    ManualStep(
        "Glue it to the rim",
        "glue",
        ("sheet", "stretch_jig", "frame"),
        "Put a thin, even bead of adhesive on the front of the rim only. Push the frame from "
        "below into the jig, which guides it, until the rim lifts the rubber by half a "
        "millimetre. Put a weight on it and let it cure. The pre-stretch is fixed from now "
        "on.",
    ),
    ManualStep(
        "Clamp",
        "clamp",
        ("bolts", "clamp_ring", "membrane", "frame"),
        "Cut the rubber off around the flange, fold it down around the rim, and lay the "
        "clamping ring over it. Punch the {bolts} holes through the ring and insert the "
        "bolts ({bolt}). The bolt heads stay {recess:g} mm behind the membrane, so only "
        "rubber is in front.",
    ),
    ManualStep(
        "Glass and mount",
        "glass",
        ("frame", "gasket", "glass", "glass_seat", "camera_mount", "nuts"),
        "Clean glass and lens first; they cannot be reached later. Put the gasket (cut along "
        "[gasket.svg](gasket.svg)) on the back of the frame, the glass in its seat, the "
        "mount behind it, and the nuts on. Tighten crosswise, a quarter turn beyond "
        "finger-tight.",
    ),
    ManualStep(
        "Closed",
        "section",
        (
            "clamp_ring",
            "membrane",
            "frame",
            "gasket",
            "glass",
            "glass_seat",
            "camera_mount",
            "led_ring",
            "camera",
            "bolts",
            "nuts",
        ),
        "A section through the center. Membrane to glass: {depth:g} mm; pupil to glass: "
        "{distance:g} mm. Screw or glue the air port into the hole on the +x side ({port}). "
        "Inflate to {supply:g} kPa under water or with soap: no bubbles may appear.",
        cut=True,
    ),
    ManualStep(
        "Expected camera image",
        "camera_view",
        (),
        "The simulated image of the flat membrane. {mirrors}",
    ),
    ManualStep(
        "Measure",
        "",
        (),
        "Name a calibration file in the rig file, then run\n"
        "\n"
        "    mjtactile doctor --rig my_gripper.toml\n"
        "    mjtactile calibrate valve --rig my_gripper.toml --finger left\n"
        "    mjtactile calibrate frame --rig my_gripper.toml --finger left\n"
        "    mjtactile calibrate force --rig my_gripper.toml --finger left\n"
        "    mjtactile record --rig my_gripper.toml --out runs/manually\n"
        "\n"
        "`calibrate frame` measures the as-built values: camera pose, marker radii, and "
        "stiffness of the rubber. `mjtactile fit` writes the sensor file of the as-built "
        "sensor. The hose and the port hold {hose:.2f} mL: write that into "
        "`chamber.extra_volume_mL`.",
    ),
)
FIDUCIALS = {
    "rim": ManualStep(
        "Fixed reference circles",
        "fiducials",
        (),
        "Print [fiducials.pdf](fiducials.pdf) in matte black on white matte film of 0.1 mm "
        "and check its scale bars. Cut it in strips along the red lines. Glue them "
        "permanently through the back of the frame to the inner face of its rim, behind the "
        "lip of {lip:g} mm, circles to the camera, within 0.2 mm of their positions. Every "
        "rest reference measures their actual positions; only a strip that comes loose later "
        "causes errors.",
    ),
    "pane": ManualStep(
        "Fixed reference circles",
        "fiducials",
        (),
        "Transfer [fiducials.pdf](fiducials.pdf) onto the inner face of the glass, white "
        "under black, within 0.2 mm of the edges of the glass, before the glass goes into "
        "its seat. Every rest reference measures their actual positions.",
    ),
}
"""Assembly step of a sensor with fiducials, by their surface; before the membrane is glued."""
SHEET = "sheet"
"""Stretched membrane on the jig; it appears only in the images."""


def steps_of(layout: Layout) -> tuple[ManualStep, ...]:
    """The steps of this sensor's assembly."""
    fiducials = layout.design.fiducials
    if fiducials is None:
        return STEPS
    at = next(k for k, step in enumerate(STEPS) if step.picture == "stretch")
    return (*STEPS[:at], FIDUCIALS[fiducials.surface], *STEPS[at:])


def facts(layout: Layout, optics: Optics) -> dict[str, Any]:
    """Return the values used in the texts of the steps."""
    design = layout.design
    half = page_size(layout)
    seen = mirrored_in_image(design, optics.mirrors)
    first = optics.mirrors[0]
    if layout.hardware.markers == "ink":
        ink = (
            "Lay the stencil on it and rub on elastic ink (silicone ink on silicone, latex "
            "ink on latex), or transfer the print. The ink must be thin and elastic: stiff "
            "ink holds the rubber and ends up smaller than the mounted size. For stiff ink "
            "or glued discs, make the folder again with `--markers discs`."
        )
    else:
        ink = (
            "Glue the discs through the stencil. They are stiffer than the rubber and keep "
            "their size; their positions are those before stretching."
        )
    mirrors = "The image contains no reflection of an LED in the glass."
    if seen:
        mirrors = (
            f"The glass reflects {seen} of {len(optics.mirrors)} LEDs into the image, the "
            f"first at {first[0]:.0f}, {first[1]:.0f} px (circles); the simulator does not "
            "render that. Remove the reflections with crossed polarizing films on LEDs and "
            "lens, or with anti-reflection coated glass; otherwise the markers there are "
            "lost."
        )
    return {
        "lip": 0.0 if layout.groove is None else -layout.groove[1],
        "spacer": hw.SPACER,
        "pupil": layout.hardware.pupil,
        "focus": optics.focus,
        "exposure": 1e6 * optics.exposure,
        "square": MM * board_of(design).square,
        "bar": "both must have the stated length, within 0.2 %",
        "sheet": f"{2 * half[0]:.1f} x {2 * half[1]:.1f} mm",
        "ink": ink,
        "stretch": design.membrane.pre_stretch,
        "bolts": len(layout.bolts),
        "bolt": f"{layout.bolt.name} x {layout.bolt_length}",
        "recess": hw.RECESS,
        "depth": MM * design.chamber.depth,
        "distance": MM * design.glass.distance,
        "port": layout.port.what,
        "supply": 1e-3 * design.chamber.supply_gauge,
        "hose": hose_volume(layout),
        "mirrors": mirrors,
    }


def assembly(layout: Layout, optics: Optics, pictures: Sequence[str]) -> str:
    """Return the text of `assembly.md`; `pictures` are the available images."""
    known = facts(layout, optics)
    blocks = [
        f"# Assembly of {layout.design.name!r}",
        "Lengths in mm. +x is the side of the air port, the right side of the camera image.",
    ]
    for number, step in enumerate(steps_of(layout)):
        if step.picture in pictures:
            picture = f"![{step.title}](pictures/{step.picture}.png)"
        else:
            picture = ""
        blocks += [f"## {number}. {step.title}", picture, step.text.format(**known)]
    return "\n\n".join(block for block in blocks if block) + "\n"


def readme(
    layout: Layout,
    optics: Optics,
    parts: Mapping[str, Part],
    checks: Mapping[str, str],
    source: str,
) -> str:
    """The text of `README.md`."""
    made = [part for part in parts.values() if part.make]
    sizes = {part.name: " x ".join(f"{s:.1f}" for s in part.size) for part in made}
    rows = "\n".join(
        f"| `{p.name}` | {sizes[p.name]} | {1e-3 * p.volume:.2f} | {p.what} |" for p in made
    )
    checked = "\n".join(f"| {what} | {value} |" for what, value in checks.items())
    fixed = ""
    if layout.design.fiducials is not None:
        fixed = (
            "| [fiducials.pdf](fiducials.pdf), [fiducials.svg](fiducials.svg) | fixed "
            "reference circles at 1:1 |\n"
        )
    return f"""# Sensor {layout.design.name!r}: files for manufacturing

Made by `mjtactile fabricate` from `{source}`; `sensor.toml` is a copy of it. Start with
[assembly.md](assembly.md); the parts to buy are in [bill.md](bill.md).

| file | content |
|---|---|
| [assembly.md](assembly.md) | assembly steps with images |
| [bill.md](bill.md) | parts to buy, with their requirements |
| [markers.pdf](markers.pdf) | 1:1: transfer print, stencil, mounted pattern; scale bars |
| [markers.svg](markers.svg), [stencil.svg](stencil.svg) | the first two for cutters, mm |
| [board.pdf](board.pdf), [board.svg](board.svg) | ChArUco board for `mjtactile calibrate camera` |
| [led_ring.svg](led_ring.svg), [gasket.svg](gasket.svg) | outlines to cut or for a circuit board |
{fixed}| `cad/*.step`, `cad/*.stl` | the parts below, exact and as triangles; mm, sensor frame |
| `checks.json` | the numbers below and more, for programs |

| part | size, mm | volume, cm3 | |
|---|---|---|---|
{rows}

## Checks

| quantity | |
|---|---|
{checked}
"""


def checks(
    layout: Layout, optics: Optics, press: float, states: Sequence[MembraneState], gap: float
) -> dict[str, str]:
    """Return the checked values as readable text."""
    design = layout.design
    hardware = layout.hardware
    grown = growth(layout.design, states)
    seems = MM * grown * design.camera.distance
    if hardware.markers == "ink":
        size = (
            f"ink grows with the rubber, by up to {100 * grown:.1f} % (mean of all), and then "
            f"appears {seems:.2g} mm nearer; discs do not"
        )
    else:
        size = "discs keep their size"
    simulated = (
        f"markers in the image, {len(states)} simulated states to {MM * press:.2g} mm of "
        f"indentation and {1e-3 * design.chamber.supply_gauge:g} kPa"
    )
    return {
        "rubber": (
            f"stretched up to {max(state.stretch for state in states):.2f} of its free length; "
            f"the simulated material law holds to {STRETCHED:g}"
        ),
        "markers' size": size,
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
        "pane": f"bending stress {glass_stress(design):.2g} MPa of {hw.GLASS_STRESS:g} allowed",
        "bolts": f"{abs(design.chamber.supply_gauge) * design.frame.area / len(layout.bolts):.2g} "
        f"N each of {hw.BOLT_LOAD:g}",
        "parts": f"closed, without intersections, {gap:.2g} mm between parts that must not touch",
    }
