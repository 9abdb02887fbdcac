"""`README.md` and `assembly.md` of an output folder: file list, checked numbers, and illustrated
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
    """A step and its picture: `parts` by name, from front to back, pulled apart unless it is a
    `cut`; `{}` in the text are `facts`."""

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
        "From the front, left, to the back. Frame, clamping ring, glass seat, camera mount and the "
        "stretching jig are made from `cad/`; the rest is in [bill.md](bill.md). Print the parts "
        "in PETG, ABS or resin with at least four perimeters (air must not pass), or have them "
        "milled. Break the outer edges of the frame's rim by 0.5 mm and polish them: the rubber "
        "lies on them.",
    ),
    ManualStep(
        "The camera looks first",
        "camera",
        ("led_ring", "camera_mount", "camera"),
        "Solder the LED ring after [led_ring.svg](led_ring.svg) and glue it into the mount, LEDs "
        "to the front, wires through the small hole on the +x side. Screw the camera on from "
        "behind with {spacer:g} mm spacers, lens through the large hole, the picture's right side "
        "to +x (the side of the air port). The LEDs' faces must be in the plane of the lens's "
        "pupil, {pupil:g} mm before the camera board. Focus on {focus:.1f} mm from the pupil, lock "
        "the lens, set exposure to {exposure:.0f} us and fix gain and white balance. Print "
        "[board.pdf](board.pdf), glue it to something flat, and calibrate before the pane is in "
        "the way:\n"
        "\n"
        "    mjtactile calibrate camera --rig my_gripper.toml --finger left --square-mm {square:g}",
    ),
    ManualStep(
        "Markers on the rubber",
        "print",
        (),
        "Measure the scale bars of [markers.pdf](markers.pdf), both ways: {bar}. Cut the "
        "rubber to {sheet}. Lay it flat, "
        "**not stretched**. {ink} Punch the pegs' holes (crosses along the edge, 2.5 mm).",
    ),
    ManualStep(
        "Stretch",
        "stretch",
        ("sheet", "stretch_jig"),
        "Hang the sheet on the pegs of the jig, markers down. That stretches it by {stretch:g} "
        "both ways, alike in all directions: the middle stays where it is, circles stay circles. "
        "Lay page 3 of [markers.pdf](markers.pdf), printed on film, on it: markers must lie within "
        "0.3 mm. Where one side is off, move its pegs' holes.",
    ),
    ManualStep(
        "Glue it to the rim",
        "glue",
        ("sheet", "stretch_jig", "frame"),
        "Put a thin, even bead of adhesive on the front of the rim only. Push the frame from below "
        "into the jig, which guides it, until the rim lifts the sheet by half a millimetre; weigh "
        "it down and let it cure. From now on the pre-stretch is fixed.",
    ),
    ManualStep(
        "Clamp",
        "clamp",
        ("bolts", "clamp_ring", "membrane", "frame"),
        "Cut the sheet off around the flange, fold it down around the rim, and lay the clamping "
        "ring over it. Punch the {bolts} holes through the ring and put the bolts in ({bolt}). The "
        "bolts' heads stay {recess:g} mm behind the membrane: nothing but rubber is in front.",
    ),
    ManualStep(
        "Pane and mount",
        "glass",
        ("frame", "gasket", "glass", "glass_seat", "camera_mount", "nuts"),
        "Gasket (cut along [gasket.svg](gasket.svg)) on the back of the frame, the pane in its "
        "seat, the mount behind it, nuts on; tighten crosswise, a quarter turn after they are "
        "hand-tight. Clean pane and lens before: nothing can be reached later.",
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
        "A cut through the middle. Membrane to pane: {depth:g} mm; pupil to pane: {distance:g} mm. "
        "Screw or glue the air port into the hole on the +x side ({port}). Inflate to {supply:g} "
        "kPa under water or with soap: no bubbles.",
        cut=True,
    ),
    ManualStep(
        "What the camera should see",
        "camera_view",
        (),
        "The simulated picture of the flat membrane. {mirrors}",
    ),
    ManualStep(
        "Measure",
        "",
        (),
        "Name a calibration file in the rig file, then\n\n    mjtactile doctor --rig "
        "my_gripper.toml\n    mjtactile calibrate valve --rig my_gripper.toml --finger left\n    "
        "mjtactile calibrate frame --rig my_gripper.toml --finger left\n    mjtactile calibrate "
        "force --rig my_gripper.toml --finger left\n    mjtactile record --rig my_gripper.toml "
        "--out runs/manually\n\n`calibrate frame` measures what has come out differently: where "
        "the camera sits, how large the markers really are, how stiff the rubber is. `mjtactile "
        "fit` writes the sensor file of what was built. The hose and the port hold {hose:.2f} mL: "
        "write that into `chamber.extra_volume_mL`.",
    ),
)
FIDUCIALS = {
    "rim": ManualStep(
        "Circles that do not move",
        "fiducials",
        (),
        "Print [fiducials.pdf](fiducials.pdf) in matte black on white matte film of 0.1 mm (check "
        "its scale bars), cut it in strips along the red lines, and glue them through the frame's "
        "back to the inner face of its rim, behind the lip of {lip:g} mm, circles to the camera: "
        "within 0.2 mm of their places, and for good. Each is measured where it is at every rest "
        "reference: only what comes loose later is wrong.",
    ),
    "pane": ManualStep(
        "Circles that do not move",
        "fiducials",
        (),
        "Transfer [fiducials.pdf](fiducials.pdf) onto the pane's inner face, white under black, "
        "within 0.2 mm of the pane's edges, before the pane goes into its seat. Each is measured "
        "where it is at every rest reference.",
    ),
}
"""The step of a sensor that has fiducials, by their surface; it comes before the sheet is glued."""
SHEET = "sheet"
"""The stretched sheet on the jig, a part of the pictures only."""


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
            "Lay the stencil on it and rub on elastic ink (silicone ink on silicone, latex ink on "
            "latex), or transfer the print. The ink must be thin and elastic: a stiff one holds "
            "the rubber and comes out smaller than mounted size; if yours is stiff, or you glue "
            "discs, make the folder again with `--markers discs`."
        )
    else:
        ink = (
            "Glue the discs through the stencil. They are stiffer than the rubber and keep their "
            "size; their places are those before stretching."
        )
    mirrors = "No LED's mirror image in the pane is in the picture."
    if seen:
        mirrors = (
            f"The pane mirrors {seen} of {len(optics.mirrors)} LEDs into the picture, the first at "
            f"{first[0]:.0f}, {first[1]:.0f} px (circles); the simulator does not draw that. "
            "Crossed polarising films on LEDs and lens, or an anti-reflection coated pane, take "
            "them away; without these, markers there are lost."
        )
    return {
        "lip": 0.0 if layout.groove is None else -layout.groove[1],
        "spacer": hw.SPACER,
        "pupil": layout.hardware.pupil,
        "focus": optics.focus,
        "exposure": 1e6 * optics.exposure,
        "square": MM * board_of(design).square,
        "bar": "both must be as long as they say, within 0.2 %",
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
    """The text of `assembly.md`; `pictures` are those that could be drawn."""
    known = facts(layout, optics)
    blocks = [
        f"# Assembly of {layout.design.name!r}",
        "Lengths in mm. +x is the side of the air port; the camera's picture has it on the right.",
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
            "| [fiducials.pdf](fiducials.pdf), [fiducials.svg](fiducials.svg) | the circles that "
            "do not move, at 1:1 |\n"
        )
    return f"""# Sensor {layout.design.name!r}: all that a bench needs

Made by `mjtactile fabricate` from `{source}`; `sensor.toml` is a copy of it. Begin with
[assembly.md](assembly.md); buy what is in [bill.md](bill.md).

| file | what |
|---|---|
| [assembly.md](assembly.md) | step by step, with pictures |
| [bill.md](bill.md) | what to buy, with the numbers that matter |
| [markers.pdf](markers.pdf) | markers at 1:1: transfer print, stencil, and as mounted (to \
check); scale bars |
| [markers.svg](markers.svg), [stencil.svg](stencil.svg) | the first two for cutters and lasers: \
mm, a circle each |
| [board.pdf](board.pdf), [board.svg](board.svg) | ChArUco board for `mjtactile calibrate camera` |
| [led_ring.svg](led_ring.svg), [gasket.svg](gasket.svg) | outlines to cut or to make a circuit \
board of |
{fixed}| `cad/*.step`, `cad/*.stl` | the parts below, exact and as triangles; mm, in the sensor's \
frame, so that they open in place |
| `checks.json` | the numbers below and more, for programs |

| part | size, mm | volume, cm3 | |
|---|---|---|---|
{rows}

## Checked before it was written

| what | |
|---|---|
{checked}
"""


def checks(
    layout: Layout, optics: Optics, press: float, states: Sequence[MembraneState], gap: float
) -> dict[str, str]:
    """Return the checked numbers as readable text."""
    design = layout.design
    hardware = layout.hardware
    grown = growth(layout.design, states)
    seems = MM * grown * design.camera.distance
    if hardware.markers == "ink":
        size = (
            f"ink grows with the rubber, by up to {100 * grown:.1f} % (mean of all), and then "
            f"seems {seems:.2g} mm nearer; discs do not"
        )
    else:
        size = "discs keep their size"
    simulated = (
        f"markers in the picture, {len(states)} simulated states to {MM * press:.2g} mm of press "
        f"and {1e-3 * design.chamber.supply_gauge:g} kPa"
    )
    return {
        "rubber": f"stretched up to {max(state.stretch for state in states):.2f} of its free "
        f"length; the simulator's law holds to {STRETCHED:g}",
        "markers' size": size,
        "markers to the edge of the opening": f"{min(opening_margins(design)):.2f} mm at least",
        simulated: f"{optics.margin:.0f} px to spare ({optics.worst})",
        "sharpness": f"blur {optics.blur:.2f} px (sd) from {optics.near:.1f} to {optics.far:.1f} "
        f"mm at f/{optics.stop:g}; the sensor file allows {design.camera.blur_px:g}",
        "motion blur": f"{hw.SMEAR:g} px at {hardware.speed:g} mm/s with an exposure of "
        f"{1e6 * optics.exposure:.0f} us",
        "light": f"{optics.flux:.2g} W from each of {design.leds.count} LEDs meanwhile; photon "
        f"noise {optics.noise:.1f} DN (sensor file: {design.camera.noise_dn:g})",
        "pane": f"bends with {glass_stress(design):.2g} MPa of {hw.GLASS_STRESS:g} allowed",
        "bolts": f"{abs(design.chamber.supply_gauge) * design.frame.area / len(layout.bolts):.2g} "
        f"N each of {hw.BOLT_LOAD:g}",
        "parts": f"closed, none intersects another, {gap:.2g} mm between what is not to touch",
    }
