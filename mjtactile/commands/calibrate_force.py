"""`mjtactile calibrate force`: the sensor's force against known weights or a load cell."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mjtactile.commands.calibration import check_folder, confirm, finish, say
from mjtactile.commands.output import stdout_to_stderr
from mjtactile.commands.reconstruct import load_pipeline, to_image
from mjtactile.commands.sources import read_frames
from mjtactile.errors import InputError

HELP = "the force felt, and the paper's constant c, against weights or a load cell"
DESCRIPTION = """\
Load the membrane with known forces along its normal and compare: the paper's constant c (dF = c dA,
membrane area against force), and the scale of the force that the inverse finite elements feel,
which should be 1 (a membrane that is thicker or stiffer than the sensor file says shows here).

Recorded: SOURCE is a CSV file that names images and loads. Live (--rig): the sensor takes its own
references, then asks for each load that you put on."""
EPILOG = """\
examples:
  mjtactile calibrate force loads.csv --flat flat/ --rest rest/ --pressure-kPa 1.0 --sensor my_sensor.toml
  mjtactile calibrate force loads.csv --reference my_reference.json
  mjtactile calibrate force loadcell.csv --recording runs/press --finger left
  mjtactile calibrate force --rig my_gripper.toml --finger left --weights-g 0,20,50,100

SOURCE columns: `image` (a file, or a folder of images of the same load, relative to the CSV file) and one of force_N or
mass_g (weights on a membrane that looks up):
  image,mass_g
  w000/,0
  w020/,20
With --recording DIR (a folder of `mjtactile record` or `grasp`, which has the references in it) the columns are time_s
(of the recording's clock, plus --delay-s) and force_N, as a load cell logs them; they are interpolated at each image.
Writes JSON: verdict, reasons, date, versions, scale and offset_N (load = scale * felt + offset) with _sd, residual_N,
area_constant_N_per_m2 with area_residual_N, and the table of loads.
Refused (exit code 1): fewer than 4 loads, a largest load below 0.2 N, scale off by 25 %, loads 10 % off a line, an area
that does not grow.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", nargs="?", type=Path, metavar="SOURCE.csv", help="images and loads, or times and loads")
    parser.add_argument("--sensor", default="dense", metavar="NAME|FILE.toml", help="the sensor (default: dense)")
    parser.add_argument("--reference", type=Path, metavar="FILE.json", help="of `calibrate frame` with --rest")
    parser.add_argument("--flat", type=Path, metavar="SOURCE", help="images of the flat membrane, valve open")
    parser.add_argument("--rest", type=Path, metavar="SOURCE", help="images of the inflated membrane, nothing touching")
    parser.add_argument("--pressure-kPa", dest="pressure", type=float, metavar="P", help="gauge pressure in the rest images")
    parser.add_argument("--recording", type=Path, metavar="DIR", help="the images are those of this recording")
    parser.add_argument("--delay-s", dest="delay", type=float, default=0.0, metavar="S",
                        help="to add to the load cell's times (default: 0)")
    parser.add_argument("--rig", metavar="NAME|FILE.toml", help="load a sensor of this rig instead")
    parser.add_argument("--finger", choices=["left", "right"], default="left", help="which sensor (default: left)")
    parser.add_argument("--weights-g", dest="weights", default="0,20,50,100", metavar="A,B,…",
                        help="live: masses to put on, one after the other (default: 0,20,50,100)")
    parser.add_argument("--out", type=Path, default=Path("force.json"), metavar="FILE.json", help="default: force.json")


def run(options: argparse.Namespace) -> int:
    import numpy as np

    from mjtactile.calibrate.force import calibrate_force, feel
    from mjtactile.calibrate.verdict import stamp, write
    from mjtactile.design import load_sensor

    if (options.source is None) == (options.rig is None):
        raise InputError("give either a CSV file (SOURCE) or --rig", field="SOURCE")
    check_folder(options.out)
    design = load_sensor(options.sensor)
    true, felt, areas = [], [], []
    with stdout_to_stderr(), contextlib.ExitStack() as stack:
        pipeline, loads = _source(options, design, stack)
        for name, force, images in loads:
            try:
                force_felt, area = feel(pipeline, images)
            except InputError as error:
                raise InputError(str(error), source=options.source or options.rig, field=name) from error
            true.append(force)
            felt.append(force_felt)
            areas.append(area)
    assert pipeline.reference is not None
    fit = calibrate_force(np.array(true), np.array(felt), np.array(areas), pipeline.reference.surface.area)
    result: dict[str, Any] = stamp("force", fit.reasons) | {"sensor": design.name, **fit.report()}
    constant = "none" if fit.area is None else f"{1e-3 * fit.area.constant:.1f} mN/mm2 (rms {fit.area.residual:.3f} N)"
    return finish(options, write(options.out, result), result, [
        f"{len(true)} loads up to {max(true):.2f} N: load = {fit.scale:.3f} (sd {fit.scale_sd:.3f}) x felt {fit.offset:+.3f} N, "
        f"{fit.rms:.3f} N (rms) left", f"  the paper's c: {constant}"])


Loads = Iterator[tuple[str, float, Sequence[Any]]]


def _source(options: argparse.Namespace, design, stack: contextlib.ExitStack) -> tuple[Any, Loads]:
    """A pipeline with references, and (name, true force N, images) of each load."""
    if options.rig:
        return _live(options, design, stack)
    if options.recording is not None:
        return _recording(options, design)
    return _pipeline(options, design), _table(options.source, design)


def _pipeline(options: argparse.Namespace, design):
    if options.reference is None and (options.flat is None or options.rest is None):
        raise InputError("needs --reference, or --flat and --rest, or --recording", field="--reference")
    pipeline = load_pipeline(design, options.reference)
    if options.flat is not None and options.rest is not None:
        pressure = design.chamber.supply_gauge if options.pressure is None else 1e3 * options.pressure
        pipeline.take_flat(_images(options.flat, design))
        pipeline.take_rest(_images(options.rest, design), pressure)
    if pipeline.reference is None:
        raise InputError("has no rest state: make it with `calibrate frame --rest`", source=options.reference)
    return pipeline


def _table(path: Path, design) -> Loads:
    from mjtactile.calibrate.force import GRAVITY
    from mjtactile.calibrate.verdict import read_columns

    try:
        table = read_columns(path, ("mass_g",), ("image",))
        forces = 1e-3 * GRAVITY * table["mass_g"]
    except InputError as error:
        if error.field != "mass_g":
            raise
        table = read_columns(path, ("force_N",), ("image",))
        forces = table["force_N"]
    for image, force in zip(table["image"], forces, strict=True):
        yield image, float(force), _images(path.parent / image, design)


def _images(source: Path, design) -> list[Any]:
    images = []
    for frame in read_frames(source):
        image = to_image(frame, design)
        if isinstance(image, str):
            raise InputError(image, source=source / frame.name, field="image")
        images.append(image)
    return images


def _recording(options: argparse.Namespace, design) -> tuple[Any, Loads]:
    import numpy as np

    from mjtactile.calibrate.verdict import read_columns
    from mjtactile.recording import load_recording

    recording = load_recording(options.recording)
    finger = ("left", "right").index(options.finger)
    if len(recording.references) != 2 or finger >= recording.width:
        raise InputError(f"has no references of a {options.finger} sensor", source=options.recording, field="--recording")
    pipeline = load_pipeline(design, None)
    flat, rest = recording.references
    pipeline.take_flat(list(flat.images(finger)))
    measured = rest.pressure_gauge[finger] if rest.pressure_gauge else None
    pipeline.take_rest(list(rest.images(finger)), design.chamber.supply_gauge if measured is None else measured)
    table = read_columns(options.source, ("time_s", "force_N"), fewest=2)
    times, forces = table["time_s"] + options.delay, table["force_N"]
    order = np.argsort(times)

    def loads() -> Loads:
        for number, images in enumerate(recording.images()):
            image = images[finger]
            if times.min() <= image.time <= times.max():
                yield f"cycle {number}", float(np.interp(image.time, times[order], forces[order])), [image]

    if not any(times.min() <= row[finger] <= times.max() for row in recording.columns["image_time"]):
        raise InputError("its times do not meet the recording's: --delay-s?", source=options.source, field="time_s")
    return pipeline, loads()


def _live(options: argparse.Namespace, design, stack: contextlib.ExitStack) -> tuple[Any, Loads]:
    """References and loads from one finger of a rig; nothing but its valve and camera is touched."""
    from mjtactile import control
    from mjtactile.calibrate.force import GRAVITY
    from mjtactile.calibrate.live import live_rig
    from mjtactile.devices.rig import build_device_rig
    from mjtactile.sensing.pipeline import SensorPipeline

    try:
        masses = [float(text) for text in options.weights.split(",")]
    except ValueError as error:
        raise InputError(f"{options.weights!r} is not a list of numbers", field="--weights-g") from error
    rig_file, _ = stack.enter_context(live_rig(options.rig, design))
    rig = build_device_rig(rig_file, design, name=rig_file.name)
    stack.callback(rig.close)
    finger = ("left", "right").index(options.finger)
    if finger >= len(rig.cameras):
        raise InputError(f"the rig has no {options.finger} camera", source=rig_file.path, field="--finger")
    pipelines = [SensorPipeline(design) for _ in rig.cameras]
    control.take_references(rig, pipelines, report=say)

    def loads() -> Loads:
        for mass in masses:
            confirm(f"put {mass:g} g on the middle of the {options.finger} membrane")
            yield f"{mass:g} g", 1e-3 * GRAVITY * mass, control.settled_images(rig)[finger]

    return pipelines[finger], loads()
