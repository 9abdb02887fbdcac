"""The commands of the command line: one module each with HELP, DESCRIPTION, EPILOG, `add_arguments` and `run`.

One that needs no simulator says `SIMULATES = False`.
"""

from mjtactile.commands import bench, grasp, inflate, locate, press

COMMANDS = {"grasp": grasp, "inflate": inflate, "press": press, "locate": locate, "bench": bench}
