"""Commands of the command line, one module each with DESCRIPTION, EPILOG, ARGUMENTS and `run`. A
module is imported only when its command is used.

A command that needs no simulator sets `SIMULATES = False`.
"""

COMMANDS = {
    "grasp": "grasp a fragile object, lift it, hold it, set it down",
    "probe": "squeeze an object gently and estimate its material",
    "evaluate": "run many grasps over seeds and objects: success rate, comparison of controllers",
    "experiments": "repeat the paper's experiments: figures, and a comparison with its numbers",
    "inflate": "inflate a sensor's membrane and compare its height with theory",
    "press": "press an indenter into a sensor and compare estimated with ground-truth force",
    "explore": "touch an unknown object at several places and reconstruct its surface",
    "detect-circles": "detect circular markers in images and estimate their 3D poses",
    "reconstruct": "reconstruct a membrane's surface and contact from recorded frames",
    "calibrate": "calibrate camera, valve, frame, force or gripper, "
    "from live devices or recorded input",
    "fit": "fit the simulator to recordings of a sensor: modulus, pre-stretch, friction, gas, "
    "light",
    "fabricate": "write fabrication files of a sensor: patterns, CAD, bill of materials, assembly",
    "design": "predict the performance of a sensor file, or search designs that meet requirements",
    "bench": "measure accuracy and speed; write a table, a JSON file and plots",
    "effects": "list the effects that a sensor and an object require, and their cost",
    "emulate": "run emulated hardware on serial ports and streams until stopped",
    "devices": "list cameras, serial ports and the devices that answer there",
    "setup": "create the rig file of a new gripper interactively",
    "doctor": "check cameras, servos and valves, or a simulated robot, and suggest fixes",
    "record": "record a stationary rig: images, times, pressures, servos, calibration",
    "studio": "watch a grasp live in the browser and interact with it",
    "summary": "write the HTML report of a recorded run: zoomable curves, images, 3D membranes",
    "video": "render a video of a recorded run: images, ellipses, forces over time",
    "compare-sim": "simulate a recording again and attribute the differences",
    "export": "write recordings as a LeRobot data set, MCAP, Rerun files or ROS 2 bags",
    "new": "create your own controller, sensor, object or rig from a commented copy",
    "docs": "list the documentation pages, or print one",
}
"""Command names with their description in `mjtactile --help`."""
