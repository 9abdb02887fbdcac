"""Public names refuse wrong arguments in one line that names the argument.

Each argument of each public name gets a value of no valid type. New public names fail
`test_every_public_name_is_in_a_table` until they are in a table.
"""

import inspect
import math
from functools import cache

import mujoco
import numpy as np
import pytest

import mjtactile
from mjtactile.core.errors import InputError

CAMERA = {"width": 64, "height": 48, "fx": 50.0, "fy": 50.0, "cx": 32.0, "cy": 24.0}
IMAGE = np.full((48, 64), 200, np.uint8)
COMMAND = {"opening": 0.05, "force_limit": 1.0}


@cache
def made():
    """Values that calls need."""
    command = mjtactile.Command(**COMMAND)
    gripper = mjtactile.GripperState(0.05, 0.0, 0.0, 0.0)
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    return {
        "camera": mjtactile.Camera(**CAMERA),
        "design": mjtactile.load_sensor("dense"),
        "command": command,
        "gripper": gripper,
        "observation": mjtactile.Observation(0.0, 0.04, (), gripper, (), command),
        "model": model,
        "data": mujoco.MjData(model),
        "stamp": mjtactile.CalibrationMetadata("", ""),
        "scenario": mjtactile.Scenario(),
        "rest": mjtactile.RestSurface(np.zeros((1, 3)), 1.0),
    }


# arguments of a valid call; a text after @ is a value of `made`
CALLS = {
    "Calibration": {"finger": "left", "sensor": "dense"},
    "CalibrationMetadata": {"date": "", "fingerprint": ""},
    "Camera": CAMERA,
    "Command": COMMAND,
    "Finger": {"name": "left", "design": "@design", "camera": None},
    "GripperState": {"opening": 0.0, "speed": 0.0, "effort": 0.0, "lift_height": 0.0},
    "Image": {"pixels": IMAGE},
    "LensCalibration": {**CAMERA, "stamp": "@stamp"},
    "LiveView": {"target": "foxglove"},
    "Observation": {
        "time": 0.0,
        "period": 0.04,
        "touch": (),
        "gripper": "@gripper",
        "valves": (),
        "command": "@command",
    },
    "QuasistaticMembrane": {"design": "dense"},
    "Recorder": {"folder": "unused", "header": {}},
    "RestSurface": {"points": np.zeros((1, 3)), "pressure": 1.0},
    "Scenario": {},
    "SensingPipeline": {"design": "@design"},
    "Session": {"rig": None},
    "StatefulPipeline": {"chain": None},
    "ValveState": {"is_open": True},
    "action_from_commands": {"before": "@command", "after": "@command", "period": 0.04},
    "attach": {"spec": mujoco.MjSpec(), "sensor": "dense", "site": "tip"},
    "build_rig": {"scenario": "sim"},
    "circles_to_records": {"found": None},
    "command_from_action": {"observation": "@observation", "action": (0.0, 0.0, 0.0)},
    "configure_options": {"spec": mujoco.MjSpec()},
    "detect_circles": {"image": IMAGE, "camera": "@camera", "radius": 1e-3},
    "effective_camera": {"design": "@design"},
    "estimate_force_from_surface": {
        "points": np.zeros((1, 3)),
        "pressure": 1.0,
        "outline": np.zeros((4, 2)),
        "membrane": "@rest",
    },
    "load_calibration": {"path": ""},
    "load_controller": {"name_or_path": ""},
    "load_policy": {"path": ""},
    "load_recording": {"path": ""},
    "load_rig_file": {"name_or_path": ""},
    "load_scenario": {"source": ""},
    "load_sensor": {"name_or_path": ""},
    "open_session": {"scenario": "sim"},
    "policy_data": {"recording": ""},
    "policy_observation": {"observation": "@observation"},
    "policy_observation_names": {"fingers": 2},
    "resolve_scenario": {"scenario": "@scenario"},
    "save_policy": {"path": "", "layers": [(np.ones((1, 1)), np.ones(1))]},
    "step": {"model": "@model", "data": "@data", "fingers": []},
    "track_circles": {"images": [IMAGE], "camera": "@camera", "radius": 1e-3},
}
# made by the package, or without arguments
NOT_CALLED = {
    "AttachedSensor",
    "ContactShape",
    "ControllerError",
    "DeviceError",
    "EffectiveCamera",
    "InputError",
    "Interrupted",
    "MembraneSolution",
    "MjtactileError",
    "Observer",
    "Obstacle",
    "Policy",
    "PolicyData",
    "Recording",
    "Rig",
    "SensorDesign",
    "SimFinger",
    "SimulationError",
    "SolutionSensitivities",
    "SurfaceForce",
    "Touch",
    "TrackedCircles",
    "monotonic",
    "rig_names",
}
# arguments that are Protocols or of any type
UNCHECKED = {("Finger", "camera"), ("Finger", "valve")}
CASES = [
    (name, argument)
    for name in CALLS
    for argument, one in inspect.signature(getattr(mjtactile, name)).parameters.items()
    if one.kind not in (one.VAR_KEYWORD, one.VAR_POSITIONAL) and (name, argument) not in UNCHECKED
]


def call(name, /, **changed):
    values = {
        key: made().get(value[1:]) if isinstance(value, str) and value[:1] == "@" else value
        for key, value in CALLS[name].items()
    }
    found = getattr(mjtactile, name)(**(values | changed))
    return found.__enter__() if name == "open_session" else found


def test_every_public_name_is_in_a_table():
    assert {*CALLS} | NOT_CALLED == {*mjtactile.__all__}
    assert not {*CALLS} & NOT_CALLED


@pytest.mark.parametrize(("name", "argument"), CASES)
def test_a_value_of_no_valid_type_is_refused_by_name(name, argument):
    before = [] if name != "StatefulPipeline" else [argument]
    with pytest.raises(InputError) as error:
        call(name, **{argument: object()})
    text = str(error.value)
    assert "\n" not in text
    names = {argument, "chain", "rig", "found"} if before or name == "Session" else {argument}
    assert error.value.field in names, text


RANGES = [
    ("Camera", "fx", (math.nan, math.inf, 0.0, -1.0)),
    ("Camera", "width", (0, -1, 1.5, True)),
    ("Scenario", "seed", (-1, 2**63, 0.5, math.nan, True)),
    ("Scenario", "time_limit", (0.0, -1.0, math.nan)),
    ("action_from_commands", "period", (0.0, -1.0, math.nan, math.inf)),
    ("attach", "mass", (0.0, -1.0, math.nan, math.inf)),
    ("attach", "mesh", ((13,), (13, 11, 2), (13.5, 11), ("a", "b"), 13, (5, 5))),
    ("attach", "prefix", ("a\0b", "")),
    ("configure_options", "timestep", (0.0, -1.0, 1.0, math.nan)),
    ("detect_circles", "radius", (0.0, -1.0, math.nan, math.inf, [1e-3, math.nan])),
    ("detect_circles", "min_radius_px", (0.0, -1.0, math.nan, math.inf)),
    ("detect_circles", "gamma", (0.0, -1.0, math.nan, "none")),
    ("detect_circles", "neighbours", ("some", "", 1)),
    ("detect_circles", "polarity", ("grey", "", 1)),
    ("detect_circles", "image", (np.zeros((64, 48), np.uint8), np.zeros((96, 128), np.uint8))),
    ("open_session", "workers", (-1, 1.5, math.nan)),
    ("policy_observation_names", "fingers", (-1, 10**7, 1.5)),
    ("step", "nstep", (-1, 1.5, math.nan)),
    ("track_circles", "min_radius_px", (0.0, -1.0, math.nan, math.inf)),
]


@pytest.mark.parametrize(
    ("name", "argument", "value"),
    [(name, argument, value) for name, argument, values in RANGES for value in values],
)
def test_a_value_out_of_range_is_refused(name, argument, value):
    with pytest.raises(InputError) as error:
        call(name, **{argument: value})
    assert "\n" not in str(error.value)


def test_choices_are_named():
    with pytest.raises(InputError, match=r"detect_circles: polarity: .*\(valid: dark, bright\)"):
        call("detect_circles", polarity="grey")
    with pytest.raises(InputError, match=r"scenario: nonsense: is not a field \(valid: object, "):
        mjtactile.build_rig("sim", nonsense=1)


def test_fields_next_to_a_scenario_are_refused():
    """They were ignored."""
    with pytest.raises(InputError, match="seed: is already in the scenario"):
        mjtactile.build_rig(mjtactile.Scenario(), seed=3)
    with pytest.raises(InputError, match="design: is already in the scenario"):
        mjtactile.build_rig(mjtactile.Scenario(), made()["design"])
