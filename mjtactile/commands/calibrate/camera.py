"""`mjtactile calibrate camera`: lens and focal length from images of a ChArUco board, or of circles
on a grid."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mjtactile import InputError
from mjtactile.commands import arguments as arg
from mjtactile.commands.calibrate import output_options
from mjtactile.commands.calibrate.terminal import check_folder, finish, notify
from mjtactile.commands.output import print_result, stdout_to_stderr
from mjtactile.report.frame_source import read_frames

HELP = "lens and focal length from images of a printed board (ROS camera_info)"
DESCRIPTION = """\
Calibrate the intrinsics of a camera from images of a ChArUco board. Remove the membrane and the
glass, print the board (--print), glue it to something flat, and measure a square with a caliper
(--square-mm). Take 15 to 30 sharp images that together cover the whole view, most with the
board tilted by 20 to 40 degrees left, right, up or down. Do not change lens and focus later.

A flat board of equal circles on a square grid also works, as detected by
`mjtactile detect-circles` (--from-circles --pitch-mm 25.4 --radius-mm 6.35). The number of
circles does not matter, and some may be missing. This refits a camera whose file has no k3,
from the images themselves.

From images (SOURCE: a folder, an image or a video) or live (--rig FILE --finger left: move the
board; an image is taken when the board rests at a new position)."""
EPILOG = """\
examples:
  mjtactile calibrate camera --print board.png --square-mm 5
  mjtactile calibrate camera --rig my_gripper.toml --finger left
  mjtactile calibrate camera photos/ --square-mm 4.98 --rig my_gripper.toml --finger left
  mjtactile calibrate camera photos/ --out left.yaml
  mjtactile calibrate camera photos/ --from-circles --pitch-mm 25.4 --radius-mm 6.35 --out left.yaml
  mjtactile detect-circles photo.png --camera left.yaml --radius-mm 1.5

Writes the part `lens` of the finger's calibration file, or with --out FILE.yaml a ROS
camera_info. Both with verdict, reasons, date, versions, rms_px (corners, all
images), holdout_px (in held-out images), view_rms_px of each image, sd of each parameter,
coverage (fraction of the view), tilt_deg of each image, dropped images. Refused (exit code 1):
fewer than 8 usable images, rms above 0.5 px, holdout above 0.7 px, sd of the focal length
above 0.5 %, fewer than 3 images tilted by 15 degrees, corners in less than 60 % of the view.
"""

_LENGTH = arg.number(0.01, 1000)  # mm
ARGUMENTS = (
    arg.positional("source", "SOURCE", "folder, image or video of the board", nargs="?", type=Path),
    *output_options.arguments("images are taken with its camera", finger="left"),
    arg.option("--views N", "number of images to take live", 20, type=int),
    arg.option("--seconds S", "time limit for taking them", 300.0, type=float),
    arg.option("--board CxR", "number of squares of the board in x and y", "9x7"),
    arg.option("--square-mm MM", "side of a square, as measured", 5.0, type=arg.number(0.1, 1000)),
    arg.option("--marker-mm MM", "side of a marker (default: 0.75 squares)", type=float),
    arg.option("--dictionary NAME", "ArUco dictionary", "4X4_50"),
    arg.flag("--from-circles", "use a board of equal circles on a square grid"),
    arg.option("--pitch-mm MM", "distance between the centers of adjacent circles", type=_LENGTH),
    arg.option("--radius-mm MM", "radius of the circles", type=_LENGTH),
    arg.flag("--bright", "circles are bright on a dark background"),
    arg.flag(
        "--k3",
        "also fit the sixth order of the distortion (wide lenses); from circles it is fitted "
        "automatically where it is significant",
    ),
    arg.option(
        "--lens MODEL",
        "lens model, such as equidistant for a fisheye; all: docs/reference/sensor_files.md",
        "plumb_bob",
    ),
    arg.option(
        "--print FILE.png", "write the board as an image and exit", dest="print_to", type=Path
    ),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile.calibrate.camera import camera_info, lens_part, report
    from mjtactile.calibrate.intrinsics import LensFit
    from mjtactile.calibrate.result_io import stamp, stamp_of, write, write_yaml

    lens = LensFit(options.lens, options.k3)
    if options.print_to is not None:
        return _print_board(options, _board(options))
    finder, calibrate = _method(options)
    if options.source is None and options.rig is None:
        raise InputError(
            "no images are given: name them (SOURCE), or add --rig to take some", field="SOURCE"
        )
    out: Path | None = options.out
    goal = None
    if out is not None and out.suffix in (".yaml", ".yml"):
        path = check_folder(out)
    else:
        goal = output_options.find_targets(options)[0]
        path = goal.path
    with stdout_to_stderr():
        if options.source is None:
            views, size = _live(options, finder)
        else:
            views, size = _recorded(options.source, finder)
        fit = calibrate(finder, views, size, lens)
    reasons = fit.reasons if goal is None else _fits(fit, goal.design)
    verdict = stamp("camera", reasons)
    info = camera_info(fit, path.stem)
    residuals = report(fit)

    def to_yaml(path: Path, _: Any) -> None:
        write_yaml(path, {**info, "calibration": {**verdict, **residuals}})

    if goal is None:
        path = write(path, verdict, to_yaml)
    else:
        goal.write("lens", lens_part(fit, stamp_of(goal.design, residuals)), reasons)
    return finish(options, path, {**verdict, **residuals, **info}, _lines(fit))


def _lines(fit: Any) -> list[str]:
    (fx, _, cx), (_, fy, cy), _ = fit.K
    return [
        f"{len(fit.view_rms)} images, {len(fit.dropped)} dropped; corner residual "
        f"{fit.rms:.3f} px, {fit.holdout_px:.3f} px in held-out images",
        f"  focal length {fx:.2f}, {fy:.2f} px (sd {fit.sd[0]:.2f}, {fit.sd[1]:.2f}), "
        f"center {cx:.2f}, {cy:.2f} px",
        f"  {100 * fit.coverage:.0f} % of the view covered, board tilted by up to "
        f"{fit.tilts.max():.0f} degrees",
    ]


def _fits(fit, design) -> list[str]:
    """Return the reasons why the camera is rejected for this sensor; an empty list if it is
    valid."""
    size = design.camera.width, design.camera.height
    wrong = (
        f"the images have {fit.size[0]} x {fit.size[1]} pixels, but sensor {design.name!r} "
        f"has {size[0]} x {size[1]}"
    )
    return [*fit.reasons, *([wrong] if fit.size != size else [])]


def _method(options: argparse.Namespace) -> tuple[Any, Any]:
    """Return the board detector and the function that fits a camera to its points."""
    from mjtactile.calibrate.camera import BoardFinder, calibrate_camera
    from mjtactile.calibrate.circle_board import CircleFinder, calibrate_from_circles

    for name in ("pitch_mm", "radius_mm"):
        if (getattr(options, name) is not None) != options.from_circles:
            message = "--from-circles requires --pitch-mm and --radius-mm, which apply to it only"
            raise InputError(message, field=f"--{name.replace('_', '-')}")
    if not options.from_circles:
        return BoardFinder(_board(options)), calibrate_camera
    return CircleFinder(
        1e-3 * options.pitch_mm, 1e-3 * options.radius_mm, "bright" if options.bright else "dark"
    ), calibrate_from_circles


def _board(options: argparse.Namespace):
    from mjtactile.calibrate.camera import Board

    try:
        columns, rows = (int(part) for part in options.board.lower().split("x"))
    except ValueError:
        columns = rows = 0
    if columns < 3 or rows < 3:
        raise InputError(
            f"{options.board!r} is not a size such as 9x7, with at least 3 squares in each "
            "direction",
            field="--board",
        )
    square = 1e-3 * options.square_mm
    marker = 0.75 * square if options.marker_mm is None else 1e-3 * options.marker_mm
    board = Board(columns, rows, square, marker, options.dictionary)
    board.make()  # complains
    return board


def _print_board(options: argparse.Namespace, board) -> int:
    import cv2

    check_folder(options.print_to, "--print")
    if not cv2.imwrite(str(options.print_to), board.render()):
        raise InputError("the image cannot be written", source=options.print_to, field="--print")
    width, height = (1e3 * board.square * (n + 1) for n in (board.columns, board.rows))
    text = (
        f"board of {options.board} squares; print it {width:g} x {height:g} mm large (margin "
        "included) and measure a square"
    )
    print_result(
        options,
        {"file": options.print_to, "width_mm": width, "height_mm": height},
        f"{text}\nwritten to {options.print_to}",
    )
    return 0


def _recorded(source: Path, finder) -> tuple[list, tuple[int, int]]:
    views = []
    sizes = set()
    blind = 0
    for frame in read_frames(source):
        gray = frame.grey()
        if gray is None:
            raise InputError("the file cannot be read as an image", source=source / frame.name)
        sizes.add((gray.shape[1], gray.shape[0]))
        if len(sizes) > 1:
            raise InputError(f"the images have different sizes: {sorted(sizes)}", source=source)
        view = finder.find(frame.name, gray)
        blind += view is None
        if view is not None:
            views.append(view)
    if blind:
        notify(f"the board was not found in {blind} of {blind + len(views)} images")
    if not views:
        raise InputError(
            "the board was found in none of the images: check that --board and --dictionary "
            "match the print; for a board of circles add --from-circles",
            source=source,
        )
    return views, sizes.pop()


def _live(options: argparse.Namespace, finder) -> tuple[list, tuple[int, int]]:
    from mjtactile import load_sensor
    from mjtactile.calibrate.connect import live_camera, live_rig
    from mjtactile.calibrate.interactive import camera_images, collect_views

    with (
        live_rig(options.rig, load_sensor("dense")) as (rig_file, _),
        live_camera(rig_file, options.finger) as camera,
    ):
        notify(
            f"{camera.name}: hold the board still in the view for a moment; repeat at other "
            "positions and tilts. Ctrl-C aborts."
        )
        views = collect_views(camera_images(camera, options.seconds), finder, options.views, notify)
    if not views:
        raise InputError(
            f"no resting board was found within {options.seconds:g} s: check that --board and "
            "--dictionary match the print, and that the image is sharp",
            field="--rig",
        )
    return views, (camera.config.width, camera.config.height)
