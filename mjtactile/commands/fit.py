"""`mjtactile fit`: fit the simulator to recordings of a sensor."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from mjtactile import InputError
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import print_result, require_new, save_plot, stdout_to_stderr
from mjtactile.core import foreign_file
from mjtactile.recording.files import write_json
from mjtactile.runtime.progress import Progress

DESCRIPTION = """\
Identify the properties of a sensor from its recordings: modulus and pre-stretch of the
membrane, friction, gas volume, leak, heat exchange, blur, noise and light. The recorded motions
are repeated in the simulator and its parameters adjusted until markers and pressures agree with
the recorded ones. Each value has an interval; parameters that the recordings do not determine
keep the value of the file, with the recording that would determine them."""
EPILOG = """\
examples, of a sensor on a bench (`--rig stage` is a simulated one, for practice):
  mjtactile record --rig my_gripper.toml --pressure-kPa 0.5 --protocol press --seconds 11 \\
      --out runs/press_05
  mjtactile record --rig my_gripper.toml --pressure-kPa 3 --protocol press --seconds 11 \\
      --out runs/press_3
  mjtactile record --rig my_gripper.toml --protocol drag --seconds 11 --out runs/drag
  mjtactile record --rig my_gripper.toml --protocol tap --seconds 17 --out runs/tap
  mjtactile record --rig my_gripper.toml --pressure-kPa 2 --seconds 60 --out runs/still
  mjtactile fit --recording runs/press_05 --recording runs/press_3 --recording runs/drag \\
      --recording runs/tap \\
      --recording runs/still --held-out runs/other --out my_sensor.toml
  mjtactile fit --recording runs/press_3 --fix membrane.thickness_mm=0.31 --out my_sensor.toml

Writes FILE.toml, a sensor file, and next to it FILE.fit.json, FILE.fit.txt and FILE.fit.png.
The fit uses images, pressures, times, and the recorded motions (docs/how-to/identify.md), but
neither estimated forces nor ground truth. exit codes: 0 fitted, 2 bad input, 3 the simulation
failed.
"""

ARGUMENTS = (
    arg.option(
        "--recording DIR",
        "recording of `mjtactile record`; repeatable",
        type=Path,
        action="append",
        required=True,
    ),
    arg.repeated(
        "--held-out DIR",
        "recording that is not fitted but predicted, as a check; repeatable",
        type=Path,
    ),
    arg.option(
        "--relaxation DIR",
        "recording with a pressure sensor and 10 s or more without contact, after inflation "
        "or a load; the stress relaxation is fitted to it",
        type=Path,
    ),
    arg.out("sensor file to write", "FILE.toml", required=True),
    arg.sensor("initial sensor file (default: that of the recordings)", default=None, type=Path),
    arg.option("--finger NAME", "finger of the recordings", "left"),
    arg.repeated(
        "--fix FIELD=VALUE",
        "value measured by hand, such as membrane.thickness_mm=0.31; repeatable",
    ),
    arg.option(
        "--first-contact-sd-mm D",
        "standard deviation of the marked position of first contact",
        0.05,
        dest="touch",
        type=arg.number(1e-4, 10),
    ),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile.fit.identification import FitOptions, fit_recordings
    from mjtactile.fit.relaxation import fit_relaxation
    from mjtactile.fit.report import plot, text_of
    from mjtactile.fit.result import to_table

    known = dict(_known_value(text) for text in options.fix)
    files = _report_files(options.out)
    with stdout_to_stderr():
        result = fit_recordings(
            options.recording,
            sensor=options.sensor,
            known=known,
            held_out=options.held_out,
            options=FitOptions(
                finger=options.finger,
                touch_sd=1e-3 * options.touch,
                name=options.out.stem,
                notify=Progress(quiet=options.json).message,
            ),
        )
        text = text_of(result)
        sensor = result.text
        table = to_table(result)
        if options.relaxation is not None:
            fades = fit_relaxation(options.relaxation, result.design, options.finger)
            text = f"{text}\nrelaxation: {fades.sentence}"
            table |= {"relaxation": fades.to_table()}
            if fades.is_finite_value:
                sensor = f"{sensor}\n{fades.section}"
        options.out.write_text(sensor, encoding="utf-8")
        write_json(files["json"], table)
        files["txt"].write_text(text, encoding="utf-8")
        save_plot(files["png"], lambda figure: plot(figure, result), size=(13.0, 7.5))
    print_result(
        options,
        table,
        f"{text}\nwritten: {options.out}, and {', '.join(path.name for path in files.values())}",
    )
    return 0


def _report_files(out: Path) -> dict[str, Path]:
    """Return the files of the report by suffix. Raises InputError if one cannot be written."""
    if out.suffix != ".toml":
        raise InputError("the name does not end in .toml", source=out, field="--out")
    files = {kind: out.with_suffix(f".fit.{kind}") for kind in ("json", "txt", "png")}
    for path in (out, *files.values()):
        require_new(path)
    if not foreign_file.is_dir(out.parent):
        raise InputError("the folder does not exist", source=out.parent, field="--out")
    return files


def _known_value(text: str) -> tuple[str, float]:
    field, _, parsed = text.partition("=")
    try:
        value = float(parsed)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(
            f"{text!r} does not have the form FIELD=NUMBER, such as membrane.thickness_mm=0.31",
            field="--fix",
        )
    return field.strip(), value
