"""`mjtactile calibrate camera`: lens and focal length from pictures of a ChArUco board, or of
circles on a grid."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mjtactile import InputError
from mjtactile.commands import arguments as arg
from mjtactile.commands.calibrate import output_options
from mjtactile.commands.calibrate.terminal import check_folder, finish, say
from mjtactile.commands.output import print_json, stdout_to_stderr
from mjtactile.report.frame_source import read_frames

HELP = "lens and focal length from pictures of a printed board (ROS camera_info)"
DESCRIPTION = """\
Intrinsics of a camera from pictures of a ChArUco board: take the membrane and glass off, print
the board (--print), glue it to something flat, measure a square with a caliper (--square-mm).
Take 15 to 30 pictures that fill the view between them, with the board tilted by 20 to 40 degrees
left, right, up and down in most, sharp to the edges, lens and focus as they will be used.

Or of a flat board of equal circles on a square grid, such as `mjtactile detect-circles` finds
(--from-circles --pitch-mm 25.4 --radius-mm 6.35): how many there are does not matter, and
some may be missing. That refits a camera whose file has no k3, from the pictures
themselves.

From pictures (SOURCE: a folder, an image or a video) or live (--rig FILE --finger left: move the
board; a picture is taken when it rests somewhere new)."""
EPILOG = """\
examples:
  mjtactile calibrate camera --print board.png --square-mm 5
  mjtactile calibrate camera --rig my_gripper.toml --finger left
  mjtactile calibrate camera photos/ --square-mm 4.98 --rig my_gripper.toml --finger left
  mjtactile calibrate camera photos/ --out left.yaml
  mjtactile calibrate camera photos/ --from-circles --pitch-mm 25.4 --radius-mm 6.35 --out left.yaml
  mjtactile detect-circles photo.png --camera left.yaml --radius-mm 1.5

Writes the part `lens` of the finger's calibration file, or with --out FILE.yaml a ROS
camera_info (plumb_bob). Both with verdict, reasons, date, versions, rms_px (corners, all
pictures), holdout_px (in pictures that were not fitted), view_rms_px by picture, sd of each
parameter, coverage (share of the view), tilt_deg of each picture, dropped pictures. Refused
(exit code 1): fewer than 8 usable pictures, rms above 0.5 px, holdout above 0.7 px, focal
length known to less than 0.5 %, fewer than 3 pictures tilted by 15 degrees, corners in less
than 60 % of the view.
"""

ARGUMENTS = (
    arg.positional("source", "SOURCE", "folder, image or video of the board", nargs="?", type=Path),
    *output_options.arguments("pictures are taken with its camera", finger="left"),
    arg.option("--views", "N", "pictures to take live", 20, type=int),
    arg.option("--seconds", "S", "longest time to take them in", 300.0, type=float),
    arg.option("--board", "CxR", "squares of the board in x and y", "9x7"),
    arg.option("--square-mm", "MM", "side of a square, as measured", 5.0, type=float),
    arg.option("--marker-mm", "MM", "side of a marker (default: 0.75 squares)", type=float),
    arg.option("--dictionary", "NAME", "ArUco dictionary", "4X4_50"),
    arg.flag("--from-circles", "the board is one of equal circles on a square grid"),
    arg.option("--pitch-mm", "MM", "from one circle's centre to the next", type=float),
    arg.option("--radius-mm", "MM", "radius of the circles", type=float),
    arg.flag("--bright", "circles are bright on a dark ground"),
    arg.flag(
        "--k3",
        "fit the distortion's sixth order too (wide lenses); from circles it is fitted "
        "without being asked for where it is plainly there",
    ),
    arg.option(
        "--print", "FILE.png", "write the board as an image, and end", dest="print_to", type=Path
    ),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile.calibrate.camera import camera_info, lens_part, report
    from mjtactile.calibrate.result_io import stamp, stamp_of, write, write_yaml

    if options.print_to is not None:
        return _print_board(options, _board(options))
    finder, calibrate = _method(options)
    if options.source is None and options.rig is None:
        raise InputError("give pictures (SOURCE), or --rig to take some", field="SOURCE")
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
        fit = calibrate(finder, views, size, k3=options.k3)
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
    fx = fit.K[0, 0]
    fy = fit.K[1, 1]
    cx = fit.K[0, 2]
    cy = fit.K[1, 2]
    return finish(
        options,
        path,
        {**verdict, **residuals, **info},
        [
            f"{len(fit.view_rms)} pictures, {len(fit.dropped)} left out; corners fit to "
            f"{fit.rms:.3f} px, {fit.holdout_px:.3f} px in pictures that were not fitted",
            f"  focal length {fx:.2f}, {fy:.2f} px (sd {fit.sd[0]:.2f}, {fit.sd[1]:.2f}), "
            f"centre {cx:.2f}, {cy:.2f} px",
            f"  {100 * fit.coverage:.0f} % of the view seen, board tilted by up to "
            f"{fit.tilts.max():.0f} degrees",
        ],
    )


def _fits(fit, design) -> list[str]:
    """Why the camera is refused for this sensor; nothing for a good one."""
    size = design.camera.width, design.camera.height
    wrong = (
        f"the pictures have {fit.size[0]} x {fit.size[1]} pixels, sensor {design.name!r} has "
        f"{size[0]} x {size[1]}"
    )
    return [*fit.reasons, *([wrong] if fit.size != size else [])]


def _method(options: argparse.Namespace) -> tuple[Any, Any]:
    """Return the board detector and the function that fits a camera to its points."""
    from mjtactile.calibrate.camera import BoardFinder, calibrate_camera
    from mjtactile.calibrate.circle_board import CircleFinder, calibrate_from_circles

    if not options.from_circles:
        for name in ("pitch_mm", "radius_mm"):
            if getattr(options, name) is not None:
                raise InputError(
                    "is for a board of circles: give --from-circles too",
                    field=f"--{name.replace('_', '-')}",
                )
        return BoardFinder(_board(options)), calibrate_camera
    for name in ("pitch_mm", "radius_mm"):
        value = getattr(options, name)
        if value is None or not 0.01 <= value <= 1000:
            raise InputError(
                f"{value} is not from 0.01 to 1000; measure it on the board",
                field=f"--{name.replace('_', '-')}",
            )
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
            f"{options.board!r} is not like 9x7, with 3 or more squares each way", field="--board"
        )
    if not 0.1 <= options.square_mm <= 1000:
        raise InputError(f"{options.square_mm:g} is outside 0.1 to 1000", field="--square-mm")
    square = 1e-3 * options.square_mm
    marker = 0.75 * square if options.marker_mm is None else 1e-3 * options.marker_mm
    board = Board(columns, rows, square, marker, options.dictionary)
    board.make()  # complains
    return board


def _print_board(options: argparse.Namespace, board) -> int:
    import cv2

    check_folder(options.print_to, "--print")
    if not cv2.imwrite(str(options.print_to), board.draw()):
        raise InputError("cannot be written", source=options.print_to, field="--print")
    width, height = (1e3 * board.square * (n + 1) for n in (board.columns, board.rows))
    text = (
        f"board of {options.board} squares; print it {width:g} x {height:g} mm large (margin "
        "included), check a square"
    )
    if options.json:
        print_json({"file": options.print_to, "width_mm": width, "height_mm": height})
    else:
        print(f"{text}\nwritten to {options.print_to}")
    return 0


def _recorded(source: Path, finder) -> tuple[list, tuple[int, int]]:
    views = []
    sizes = set()
    blind = 0
    for frame in read_frames(source):
        gray = frame.grey()
        if gray is None:
            raise InputError("cannot be read as an image", source=source / frame.name)
        sizes.add((gray.shape[1], gray.shape[0]))
        if len(sizes) > 1:
            raise InputError(f"pictures of different sizes: {sorted(sizes)}", source=source)
        view = finder.find(frame.name, gray)
        blind += view is None
        if view is not None:
            views.append(view)
    if blind:
        say(f"the board was not found in {blind} of {blind + len(views)} pictures")
    if not views:
        raise InputError(
            "the board is in none of the pictures: are --board and --dictionary those of the "
            "print, or is it one of circles (--from-circles)?",
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
        say(
            f"{camera.name}: hold the board into the view, still for a moment; then elsewhere, "
            "tilted. Ctrl-C gives up."
        )
        views = collect_views(camera_images(camera, options.seconds), finder, options.views, say)
    if not views:
        raise InputError(
            f"the board was never seen resting within {options.seconds:g} s: are --board and "
            "--dictionary those of the print, and is it sharp?",
            field="--rig",
        )
    return views, (camera.config.width, camera.config.height)
