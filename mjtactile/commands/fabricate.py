"""`mjtactile fabricate`: generate the files needed to build the sensor from its sensor file."""

from __future__ import annotations

import argparse

from mjtactile import load_sensor
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import output_folder, print_json, stdout_to_stderr
from mjtactile.core import resources
from mjtactile.recording.files import write_json
from mjtactile.runtime.progress import Progress

DESCRIPTION = """\
Write all files needed to build the sensor of a sensor file: the marker pattern at 1:1, shrunk
by the pre-stretch (markers.svg, stencil.svg, markers.pdf), the board for `calibrate camera`,
frame, clamping ring, glass seat, camera mount and a stretching jig as STEP and STL, the LED
ring, a bill of materials and assembly.md with a figure for each step.

The simulator first checks the design: the image contains every marker of the flat, inflated and
indented membrane, sharp and without smear; markers, walls, bolts and glass can be manufactured;
parts do not intersect. A design that fails is refused with the field and its limit, and nothing
is written."""
EPILOG = """\
examples:
  mjtactile fabricate dense --out build
  mjtactile new sensor my_sensor && mjtactile fabricate my_sensor.toml --out build/my_sensor
  mjtactile fabricate dense --out build --pixel-um 3.45 --camera-holes-mm 32 --lens-mm 16
  mjtactile fabricate dense --out build --markers discs
      stiff discs, which keep their size when the rubber is stretched
  mjtactile fabricate dense --out build --speed-mm-s 100     shorter exposure, more light

Start with README.md in the folder. Lengths are in mm; parts are in the sensor's frame (z
outward, membrane at 0). Needs `pip install 'mjtactile[fabrication]'`. More:
`mjtactile docs fabricate`.
JSON: {"sensor": …, "out": …, "files": [...], "checks": {check: result}, "optics": {…},
"parts": {name: {"size_mm", "volume_mm3"}}} exit codes: 0 written, 2 cannot be built, or bad
input
"""
ARGUMENTS = (
    arg.positional("sensor", "NAME|FILE.toml", "sensor: a shipped name or a file"),
    arg.out("folder for all files; nothing is overwritten", required=True),
    arg.choice(
        "--markers",
        ("ink", "discs"),
        "elastic ink that stretches with the rubber (default), or discs that keep their size",
        "ink",
    ),
    arg.option(
        "--press-mm D",
        "maximum indentation in the camera image (default: 4, or a quarter of chamber "
        "or frame if smaller)",
        type=arg.number(0, 100),
    ),
    arg.option(
        "--speed-mm-s V",
        "speed of a marker that smears by 0.05 px (default: 25, the closing speed of "
        "controllers/gentle.py)",
        25.0,
        type=arg.number(0.1, 5000),
    ),
    arg.option("--pixel-um P", "pixel pitch of the camera", 3.0, type=arg.number(0.5, 50)),
    arg.option(
        "--f-number N",
        "of the lens (default: the widest that is sharp enough)",
        type=arg.number(0.7, 32),
    ),
    arg.option(
        "--camera-holes-mm A",
        "spacing of the camera board's M2 holes",
        28.0,
        type=arg.number(8, 100),
    ),
    arg.option(
        "--lens-mm D", "diameter of the lens barrel or holder", 14.0, type=arg.number(3, 50)
    ),
    arg.option(
        "--pupil-mm B",
        "distance from the front of the camera board to the lens's entrance pupil",
        12.0,
        type=arg.number(4, 60),
    ),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile.fabrication.build import build, write
    from mjtactile.fabrication.purchased_parts import Hardware

    design = load_sensor(options.sensor)
    path = resources.find(options.sensor, "models/sensors", ".toml")
    hardware = Hardware(
        pixel=1e-3 * options.pixel_um,
        f_number=options.f_number,
        holes=options.camera_holes_mm,
        lens=options.lens_mm,
        pupil=options.pupil_mm,
        speed=options.speed_mm_s,
        press=options.press_mm,
        markers=options.markers,
    )
    with (
        output_folder(options.out, "README.md", "assembly.md", "cad", "pictures") as out,
        stdout_to_stderr(),
    ):
        made = build(
            design,
            hardware,
            path.name,
            path.read_text(encoding="utf-8"),
            Progress(quiet=options.json).message,
        )
        write(made.files, out)
        write_json(out / "checks.json", made.report)
    if options.json:
        print_json(made.report | {"out": options.out, "files": sorted(made.files)})
    else:
        for check, result in made.report["checks"].items():
            print(f"{check}: {result}")
        print(f"{len(made.files) + 1} files were written: start with {options.out / 'README.md'}")
    return 0
