"""Commands of the command line, one module each with DESCRIPTION, EPILOG, ARGUMENTS and `run`. A
module is imported only when its command is used.

A command that needs no simulator sets `SIMULATES = False`.
"""

COMMANDS = {
    "grasp": "grasp a fragile object, lift it, hold it, set it down",
    "probe": "squeeze an object gently and say what it is made of",
    "evaluate": "many grasps with other seeds and objects: how often a controller holds, and which "
    "is better",
    "experiments": "the paper's experiments again: figures, and our numbers beside its own",
    "inflate": "inflate a sensor's membrane and compare its height with theory",
    "press": "drive an indenter into a sensor and compare the felt with the true force",
    "explore": "touch an unknown object here and there until its surface is known",
    "detect-circles": "find circular markers in images and say where they are in 3D",
    "reconstruct": "reconstruct a membrane's surface and contact from recorded frames",
    "calibrate": "calibrate camera, valve, frame, force or gripper, "
    "from live devices or recorded input",
    "fit": "fit the simulator to recordings of a sensor: modulus, pre-stretch, friction, gas, "
    "light",
    "fabricate": "from a sensor file to a sensor on the bench: patterns, CAD, bill of materials, "
    "assembly",
    "design": "predict what a sensor file reaches before it is built, and which file would reach "
    "what is wanted",
    "bench": "measure accuracy and speed; writes a table, a JSON and plots",
    "effects": "list the effects that a sensor and an object call for, and their price",
    "emulate": "start emulated hardware on serial ports and streams, until stopped",
    "devices": "list cameras and serial ports, and who answers there",
    "setup": "make the rig file of a new gripper, by questions",
    "doctor": "check cameras, servos and valves, or a simulated robot, and say how to mend what is "
    "wrong",
    "record": "record a rig that stands still: images, times, pressures, servos, calibration",
    "studio": "watch a grasp live in the browser, and reach in",
    "summary": "the page of a recorded run: curves to zoom, images by a slider, membranes to turn",
    "video": "film a recorded run: images, ellipses, forces over time",
    "compare-sim": "simulate a recording again, and attribute the difference",
    "export": "write recordings as a LeRobot data set, MCAP, Rerun's files or ROS 2 bags",
    "new": "start your own controller, sensor, object or rig from a commented copy",
    "docs": "the documentation's pages: list them, or print one",
}
"""Command names with their description in `mjtactile --help`."""
