"""`mjtactile calibrate force`: the sensor's force against known weights or a load cell."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mjtactile import Calibration, InputError, SensorDesign, load_sensor
from mjtactile.commands import arguments as arg
from mjtactile.commands.calibrate import output_options
from mjtactile.commands.calibrate.terminal import ask, confirm, finish_all, notify
from mjtactile.commands.output import stdout_to_stderr
from mjtactile.report.frame_source import read_images
from mjtactile.types import Image

HELP = "estimated force, and the paper's constant c, against weights or a load cell"
DESCRIPTION = """\
Load the membrane with known forces along its normal and compare them with the estimates. This
gives the scale of the force from the inverse finite elements, which should be 1 (otherwise the
membrane differs from the sensor file), and the paper's constant c (dF = c dA, membrane area
against force). Calibrate camera and valve first: the scale refers to a sensor with its own lens
and pressure zero.

Live (--rig): the sensors take their own references. With --load-cell the jaws then squeeze a
load cell that you put between them, and you enter its readings. Otherwise you put known weights
on a membrane that faces up. Recorded: SOURCE is a CSV file of images and loads."""
EPILOG = """\
examples:
  mjtactile calibrate force --rig my_gripper.toml --load-cell           both fingers at once
  mjtactile calibrate force --rig my_gripper.toml --finger left --weights-g 0,20,50,100
  mjtactile calibrate force loads.csv --flat flat/ --rest rest/ --pressure-kPa 1.0 --rig \\
      my_gripper.toml --finger left
  mjtactile calibrate force loads.csv --out left.json
      references: the part `frame` in left.json
  mjtactile calibrate force loadcell.csv --recording runs/press --rig my_gripper.toml --finger left

SOURCE columns: `image` (a file, or a folder of images of the same load, relative to the CSV
file) and one of force_N or mass_g (weights on a membrane that faces up):
  image,mass_g
  w000/,0
  w020/,20
With --recording DIR (a folder of `mjtactile record` or `grasp`, which contains the references)
the columns are time_s (of the recording's clock, plus --delay-s) and force_N, as logged by a
load cell; they are interpolated at each image. Writes the part `force` of each finger's
calibration file: scale (load = scale * estimate + offset) with scale_sd, offset_N (from the
support or the zero of the load cell; not applied), residual_N, area_constant_N_per_m2 with
area_residual_N, and the table of loads.
With an emulated rig the jaws squeeze its object (--object), and the emulated world provides
the load cell. Refused (exit code 1): fewer than 4 loads, a largest load below 0.2 N, scale off
by 25 %, loads 10 % off a line, an area that does not grow.
"""

ARGUMENTS = (
    arg.positional(
        "source",
        "SOURCE.csv",
        "CSV file of images and loads, or of times and loads",
        nargs="?",
        type=Path,
    ),
    *output_options.arguments("its sensors are loaded"),
    arg.option("--flat SOURCE", "images of the flat membrane, valve open", type=Path),
    arg.option("--rest SOURCE", "images of the inflated membrane without contact", type=Path),
    arg.option(
        "--pressure-kPa P",
        "gauge pressure in the rest images, from the pressure sensor",
        dest="pressure",
        type=float,
    ),
    arg.option("--recording DIR", "use the images of this recording", type=Path),
    arg.option(
        "--delay-s S", "delay to add to the load cell's times", 0.0, dest="delay", type=float
    ),
    arg.flag("--load-cell", "live: squeeze a load cell between the jaws"),
    arg.option("--force-N F", "live: maximum squeezing force", 1.5, dest="force", type=float),
    arg.option(
        "--weights-g A,B,…",
        "live: masses to apply one after the other",
        "0,20,50,100",
        dest="weights",
    ),
    arg.option("--object NAME|FILE.xml", "emulated rig: object to squeeze", "egg"),
)


Loads = Iterator[tuple[str, float, Sequence[Sequence[Image]]]]
"""Loads, each with a name, the ground-truth force, N, and images of each measured finger."""


def run(options: argparse.Namespace) -> int:
    from mjtactile.calibrate.force import calibrate_force, force_part
    from mjtactile.calibrate.result_io import stamp, stamp_of

    if options.source is None and options.rig is None:
        message = "no loads are given: name a CSV file (SOURCE), or add --rig to load its sensors"
        raise InputError(message, field="SOURCE")
    targets = output_options.find_targets(options)
    with stdout_to_stderr():
        if options.source is None:
            pipelines, loads = _live(options, targets)
        else:
            pipelines, loads = _recorded(options, targets[0])
        true, estimated, areas = _estimate_all(options, pipelines, loads)
    results = {}
    for goal, pipeline, forces, area in zip(targets, pipelines, estimated, areas, strict=True):
        fit = calibrate_force(true, forces, area, pipeline.state.reference.surface.area)
        goal.write("force", force_part(fit, stamp_of(goal.design, fit.report())), fit.reasons)
        results[goal.finger] = (
            goal.path,
            stamp("force", fit.reasons) | {"sensor": goal.design.name, **fit.report()},
            _lines(fit),
        )
    return finish_all(options, results)


def _estimate_all(
    options: argparse.Namespace, pipelines: Sequence[Any], loads: Loads
) -> tuple[Any, Any, Any]:
    """Return the applied forces (n,), and the estimated forces and areas of each finger (fingers,
    n)."""
    import numpy as np

    from mjtactile.calibrate.force import mean_force

    true = []
    estimated = []
    for name, force, shots in loads:
        try:
            estimated.append(
                [
                    mean_force(pipeline, images)
                    for pipeline, images in zip(pipelines, shots, strict=True)
                ]
            )
        except InputError as error:
            raise InputError(
                str(error), source=options.source or options.rig, field=name
            ) from error
        true.append(force)
    forces, areas = np.array(estimated).reshape(-1, len(pipelines), 2).transpose(2, 1, 0)
    return np.array(true), forces, areas


def _lines(fit: Any) -> list[str]:
    if fit.area is None:
        constant = "none"
    else:
        constant = f"{1e-3 * fit.area.constant:.1f} mN/mm2 (rms {fit.area.residual:.3f} N)"
    return [
        f"  {len(fit.true)} loads up to {max(fit.true):.2f} N: load = {fit.scale:.3f} (sd "
        f"{fit.scale_sd:.3f}) x estimate {fit.offset:+.3f} N, residual {fit.rms:.3f} N (rms)",
        f"  constant c of the paper: {constant}",
    ]


# -- recorded
# --------------------------------------------------------------------------------


def _recorded(
    options: argparse.Namespace, goal: output_options.OutputFile
) -> tuple[list[Any], Loads]:
    before = _without_scale(goal)
    if options.recording is not None:
        pipeline, loads = _recording(options, goal, before)
    else:
        # before the references, which take a while: the table may be bad
        loads = _table(options.source, goal.design)
        pipeline = _references(options, goal, before)
    return [pipeline], ((name, force, [images]) for name, force, images in loads)


def _without_scale(goal: output_options.OutputFile) -> Calibration:
    """Return the other parts of the finger's calibration."""
    return replace(goal.load().used(goal.design), force=None)


def _references(
    options: argparse.Namespace, goal: output_options.OutputFile, before: Calibration
) -> Any:
    """Return a sensing pipeline with references from --flat and --rest.

    Without them, the references come from the calibration's own part `frame`.
    """
    from mjtactile import SensingPipeline, StatefulPipeline
    from mjtactile.runtime.re_estimation import zeroed_pipeline

    if options.flat is not None and options.rest is not None:
        reading = None if options.pressure is None else 1e3 * options.pressure
        flat, rest = (read_images(source, goal.design) for source in (options.flat, options.rest))
        return zeroed_pipeline(goal.design, before, flat, rest, reading)
    pipeline = SensingPipeline(goal.design, before)
    state = pipeline.restored_state()
    if state.reference is None:
        message = (
            "references are missing: add --flat and --rest, or --recording, or run "
            "`calibrate frame` with rest images for this file"
        )
        raise InputError(message, source=goal.path, field="frame.rest")
    return StatefulPipeline(pipeline, state, contact_shapes=False)


def _table(path: Path, design: SensorDesign) -> Iterator[tuple[str, float, list[Image]]]:
    """Read and check the lines of a table of loads. Images are read only when required."""
    from mjtactile.calibrate.force import GRAVITY
    from mjtactile.calibrate.result_io import read_columns

    try:
        table = read_columns(path, ("mass_g",), ("image",))
        forces = 1e-3 * GRAVITY * table["mass_g"]
    except InputError as error:
        if error.field != "mass_g":
            raise
        table = read_columns(path, ("force_N",), ("image",))
        forces = table["force_N"]
    return (
        (image, float(force), read_images(path.parent / image, design))
        for image, force in zip(table["image"], forces, strict=True)
    )


def _recording(
    options: argparse.Namespace, goal: output_options.OutputFile, before: Calibration
) -> tuple[Any, Iterator[tuple[str, float, list[Image]]]]:
    import numpy as np

    from mjtactile import load_recording
    from mjtactile.calibrate.result_io import read_columns
    from mjtactile.runtime.re_estimation import zeroed_pipeline
    from mjtactile.types import FINGERS

    recording = load_recording(options.recording)
    finger = FINGERS.index(goal.finger)
    if len(recording.references) != 2 or finger >= recording.width:
        message = f"the recording has no references of a {goal.finger} sensor"
        raise InputError(message, source=options.recording, field="--recording")
    flat, rest = recording.references
    reading = rest.gauge_pressure[finger] if rest.gauge_pressure else None
    pipeline = zeroed_pipeline(
        goal.design, before, list(flat.images(finger)), list(rest.images(finger)), reading
    )
    table = read_columns(options.source, ("time_s", "force_N"), fewest=2)
    times = table["time_s"] + options.delay
    forces = table["force_N"]
    order = np.argsort(times)

    def loads() -> Iterator[tuple[str, float, list[Image]]]:
        for index, images in enumerate(recording.images()):
            image = images[finger]
            if times.min() <= image.time <= times.max():
                yield (
                    f"cycle {index}",
                    float(np.interp(image.time, times[order], forces[order])),
                    [image],
                )

    if not any(
        times.min() <= row[finger] <= times.max() for row in recording.columns["image_time"]
    ):
        message = "the times do not overlap the recording: check --delay-s"
        raise InputError(message, source=options.source, field="time_s")
    return pipeline, loads()


# -- live
# --------------------------------------------------------------------------------


def _live(
    options: argparse.Namespace, targets: Sequence[output_options.OutputFile]
) -> tuple[list[Any], Loads]:
    """Return the references and loads of a rig's fingers; the jaws move only with a load cell."""
    from mjtactile.calibrate.connect import live_fingers, live_rig
    from mjtactile.calibrate.interactive import keepalive, reference_images
    from mjtactile.runtime.re_estimation import zeroed_pipeline

    masses = _masses(options)
    design = load_sensor(options.sensor)
    with contextlib.ExitStack() as stack:
        rig_file, emulator = stack.enter_context(
            live_rig(options.rig, design, object_name=options.object)
        )
        maximum = rig_file.gripper.force_max
        if not 0.2 <= options.force <= maximum:
            raise InputError(
                f"{options.force:g} N is outside 0.2 to {maximum:g} N (force_max_N in the rig)",
                field="--force-N",
            )
        rig = stack.enter_context(live_fingers(rig_file, design))
        stack.enter_context(keepalive(*rig.valves))
        snapshots = reference_images(rig, notify)
        indices = output_options.camera_indices(targets, rig_file)
        with keepalive(rig.gripper):
            pipelines = [
                zeroed_pipeline(goal.design, _without_scale(goal), *snapshots[index])
                for goal, index in zip(targets, indices, strict=True)
            ]
        if options.load_cell or emulator is not None:
            cell = ask if emulator is None else _load_cell(emulator)
            loads = list(_squeezed(rig, options.force, cell, emulator is None))
        else:
            with keepalive(rig.gripper):
                loads = list(_weighed(rig, masses, " or ".join(goal.finger for goal in targets)))
    return pipelines, (
        (name, force, [shots[index] for index in indices]) for name, force, shots in loads
    )


def _masses(options: argparse.Namespace) -> list[float]:
    try:
        return [float(text) for text in options.weights.split(",")]
    except ValueError as error:
        raise InputError(
            f"{options.weights!r} is not a list of numbers", field="--weights-g"
        ) from error


def _load_cell(emulator: Any) -> Callable[[str], float | None]:
    """Return the emulated world's load cell: the force through the object. It is equal on both
    sides except for the table's friction."""

    def read(_: str) -> float:
        truth = emulator.truth()
        return (truth["contact_1"] + truth["contact_2"]) / 2

    return read


def _squeezed(
    rig: Any, maximum: float, cell: Callable[[str], float | None], manually: bool
) -> Loads:
    from mjtactile.calibrate.interactive import dropped_images, keepalive

    if manually:
        with keepalive(rig.gripper):
            confirm(
                "now put the load cell between the jaws, its button at the center of a "
                "finger; the jaws will close on it"
            )
    yield from dropped_images(
        rig, [maximum * part for part in (0.2, 0.4, 0.6, 0.8, 1.0)], cell, notify
    )


def _weighed(rig: Any, masses: Sequence[float], fingers: str) -> Loads:
    from mjtactile.calibrate.force import GRAVITY
    from mjtactile.runtime.references import settled_images

    for mass in masses:
        confirm(f"put {mass:g} g on the center of the {fingers} membrane")
        yield f"{mass:g} g", 1e-3 * GRAVITY * mass, settled_images(rig.fingers, rig.clock)
