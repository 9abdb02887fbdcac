"""Public names refuse wrong arguments in one line that names the argument.

Each argument of each public name gets a value of no valid type. New public names fail
`test_every_public_name_is_in_a_table` until they are in a table.
"""

import inspect
import math
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

import mjtactile
from mjtactile import grasp_estimation
from mjtactile.core.errors import InputError

CAMERA = {"width": 64, "height": 48, "fx": 50.0, "fy": 50.0, "cx": 32.0, "cy": 24.0}
IMAGE = np.full((48, 64), 200, np.uint8)
COMMAND = {"opening": 0.05, "force_limit": 1.0}


@cache
def made():
    """Return the arguments of the calls."""
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


@cache
def objects():
    """Return objects with public methods."""
    membrane = mjtactile.QuasistaticMembrane("dense", (9, 9))
    touch = mjtactile.Touch(0.0, 0.0, 1.0, 0.0, True)
    count = {"time": np.zeros(3), "images": np.zeros((3, 0)), "image_time": np.zeros((3, 0))}
    valves = {"valve_open": np.zeros((3, 1), bool), "opening": np.full(3, 0.05)}
    recording = mjtactile.Recording(Path("run"), {}, {}, {**count, **valves}, True, ())
    return {
        "membrane": membrane,
        "ball": membrane.obstacle("sphere", [5e-3], [0.0, 0.0, 8e-3]),
        "touch": (touch, touch),
        "recording": recording,
        "finger": mjtactile.Finger("left", made()["design"], None),  # type: ignore[arg-type]
        "calibration": mjtactile.Calibration("left", "dense"),
        "friction": grasp_estimation.FrictionFilter(),
        "load": grasp_estimation.LoadEstimator(),
        "frames": grasp_estimation.FrameLoadEstimator(),
        "stiffness": grasp_estimation.GripStiffnessEstimator(),
    }


NO_NUMBER = (object(), "x", None, [1.0])
NO_TOUCH = (object(), None, 1.0, [None], "x")
NO_PAIRS = (object(), "x", np.zeros(3), [])
NO_CYCLE = (-1, 3, 0.5, math.nan, "x", None, True)
# method, its valid arguments (@: one of `objects`), argument, wrong values
METHODS = [
    ("membrane.solve_batch", {"obstacles": [["@ball"]]}, "max_steps", (0, 0.5, math.nan, "x")),
    ("membrane.solve_batch", {"obstacles": [["@ball"]]}, "threads", (0, -1, "x", np.zeros(2))),
    ("membrane.solve_batch", {"obstacles": [["@ball"]]}, "again", (1, "no", np.zeros(2))),
    (
        "membrane.obstacle_heights",
        {"obstacles": "@ball"},
        "positions",
        (object(), "x", [[1], [2, 3]]),
    ),
    ("recording.valves", {}, "cycle", NO_CYCLE),
    ("recording.command", {}, "cycle", NO_CYCLE),
    ("recording.images_of", {}, "cycle", NO_CYCLE),
    ("recording.column", {"key": "time"}, "width", (-1, 0.5, "x", [1])),
    ("recording.column", {}, "key", (None, 1, ["time"], "none")),
    ("finger.pressure", {}, "reading", ("x", object(), [1.0])),
    ("finger.regulate_pressure", {}, "gauge_pressure", ("x", object(), math.nan)),
    ("finger.pressure_reading", {}, "valve", (1.0, "x", True)),
    ("calibration.with_refusal", {"reasons": ["a"]}, "kind", (None, 1, ["a"])),
    ("calibration.with_refusal", {"kind": "lens"}, "reasons", ("a", None, [1])),
    ("calibration.check", {"finger": "left", "source": ""}, "design", ("dense", None)),
    ("shear", {}, "touch", NO_TOUCH),
    ("external_shear", {}, "touch", NO_TOUCH),
    ("load_direction", {}, "touch", NO_TOUCH),
    ("slip_sign", {}, "touch", NO_TOUCH),
    ("estimate_friction", {}, "touch", NO_TOUCH),
    ("estimate_friction", {"touch": "@touch"}, "min_force", (-1.0, math.nan, "x")),
    ("estimate_weight", {}, "touch", NO_TOUCH),
    ("estimate_weight", {"touch": "@touch"}, "before", NO_PAIRS),
    ("estimate_weight", {"touch": "@touch"}, "acceleration", NO_NUMBER),
    ("support_force", {"touch": "@touch"}, "held", NO_PAIRS),
    ("pull_force", {"touch": "@touch"}, "held", NO_PAIRS),
    ("load_vector", {"touch": "@touch"}, "down", NO_PAIRS),
    ("min_grip_force", {"mass": 0.1, "fingers": 2}, "friction", (0.0, -1.0, "x")),
    ("min_grip_force", {"mass": 0.1, "friction": 1.0}, "fingers", (0, -1, 1.5, math.nan)),
    ("stands", {"carried": 0.1}, "held", NO_NUMBER),
    ("friction.after", {"touch": "@touch"}, "period", (0.0, -1.0, math.nan, "x")),
    ("friction.quantile", {}, "probability", (-0.1, 1.1, math.nan, "x")),
    ("friction.utilization", {}, "risk", (-0.1, 1.1, math.nan, "x")),
    ("friction.grip", {"load": 0.1}, "risk", (-0.1, 1.1, math.nan, "x")),
    ("load.after", {"touch": "@touch"}, "period", (-1.0, math.nan, "x")),
    ("load.hanging", {}, "touch", NO_TOUCH),
    ("frames.after", {"touch": "@touch", "effort": 0.0}, "period", (-1.0, math.nan, "x")),
    ("stiffness.after", {"opening": 0.0, "force": 0.0}, "period", (-1.0, math.nan, "x")),
]


def filled(value):
    if isinstance(value, list):
        return [filled(item) for item in value]
    return objects()[value[1:]] if isinstance(value, str) and value[:1] == "@" else value


@pytest.mark.parametrize(
    ("name", "valid", "argument", "value"),
    [(*case[:3], value) for case in METHODS for value in case[3]],
)
def test_a_wrong_argument_of_a_method_is_refused_by_name(name, valid, argument, value):
    owner, _, method = name.rpartition(".")
    function = getattr(objects()[owner] if owner else grasp_estimation, method)
    with pytest.raises(InputError) as error:
        function(**{key: filled(one) for key, one in valid.items()}, **{argument: value})
    text = str(error.value)
    assert "\n" not in text
    assert error.value.field == argument or "no column" in text


def test_touches_of_no_finger_give_no_values():
    assert grasp_estimation.shear(()).shape == (0, 2)
    assert math.isnan(grasp_estimation.estimate_friction(()).slipped)


@pytest.mark.parametrize(
    "pixels",
    [np.full((8, 8), 0.5), np.full((8, 8), 300), np.full((8, 8), math.nan), np.full((8, 8), -1)],
)
def test_gray_levels_are_not_rounded_silently(pixels):
    """Levels from 0 to 1 were all black, and 300 was 44."""
    with pytest.raises(InputError, match="Image: pixels: a value is not a whole number from 0"):
        mjtactile.Image(pixels)
    assert mjtactile.Image([[0, 255]]).pixels.tolist() == [[0, 255]]  # type: ignore[arg-type]
