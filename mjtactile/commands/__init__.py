"""The commands of the command line: one module each with HELP, DESCRIPTION, EPILOG, `add_arguments` and `run`.

One that needs no simulator says `SIMULATES = False`.
"""

from mjtactile.commands import (
    bench,
    calibrate,
    docs,
    doctor,
    effects,
    emulate,
    experiments,
    grasp,
    inflate,
    locate,
    new,
    press,
    probe,
    reconstruct,
    record,
)

COMMANDS = {
    "grasp": grasp, "probe": probe, "experiments": experiments, "inflate": inflate, "press": press, "locate": locate,
    "reconstruct": reconstruct, "calibrate": calibrate, "bench": bench, "effects": effects, "emulate": emulate, "doctor": doctor,
    "record": record, "new": new, "docs": docs,
}  # fmt: skip
