"""The commands of the command line: one module each with HELP, DESCRIPTION, EPILOG, `add_arguments` and `run`.

One that needs no simulator says `SIMULATES = False`.
"""

from mjtactile.commands import bench, calibrate, grasp, inflate, locate, press, reconstruct

COMMANDS = {
    "grasp": grasp, "inflate": inflate, "press": press, "locate": locate, "reconstruct": reconstruct, "calibrate": calibrate,
    "bench": bench,
}  # fmt: skip
