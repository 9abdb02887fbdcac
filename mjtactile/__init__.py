"""mjtactile: a vision-based membrane touch sensor for MuJoCo, with a gripper.

The gripper is for fragile objects. The public API consists of this package and, for MuJoCo Studio,
`mjtactile.studio`. Names are imported on first use. A rig without a simulator therefore needs no
mujoco. A rig without a camera needs no OpenCV.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mjtactile.core import platform_support

if TYPE_CHECKING:
    from mjtactile.core.calibration import Calibration as Calibration
    from mjtactile.core.calibration import load_calibration as load_calibration
    from mjtactile.core.calibration_parts import CalibrationMetadata as CalibrationMetadata
    from mjtactile.core.calibration_parts import LensCalibration as LensCalibration
    from mjtactile.core.design import SensorDesign as SensorDesign
    from mjtactile.core.design import load_sensor as load_sensor
    from mjtactile.core.errors import ControllerError as ControllerError
    from mjtactile.core.errors import DeviceError as DeviceError
    from mjtactile.core.errors import InputError as InputError
    from mjtactile.core.errors import Interrupted as Interrupted
    from mjtactile.core.errors import MjtactileError as MjtactileError
    from mjtactile.core.errors import SimulationError as SimulationError
    from mjtactile.core.optics import Camera as Camera
    from mjtactile.core.policy import action_from_commands as action_from_commands
    from mjtactile.core.policy import command_from_action as command_from_action
    from mjtactile.core.policy import policy_observation as policy_observation
    from mjtactile.core.policy import policy_observation_names as policy_observation_names
    from mjtactile.core.policy_file import Policy as Policy
    from mjtactile.core.policy_file import load_policy as load_policy
    from mjtactile.core.policy_file import save_policy as save_policy
    from mjtactile.core.scaled_clock import monotonic as monotonic
    from mjtactile.core.scenario import Scenario as Scenario
    from mjtactile.core.types.command import Command as Command
    from mjtactile.core.types.contact_shape import ContactShape as ContactShape
    from mjtactile.core.types.control import Observation as Observation
    from mjtactile.core.types.devices import GripperState as GripperState
    from mjtactile.core.types.devices import ValveState as ValveState
    from mjtactile.core.types.touch import Touch as Touch
    from mjtactile.core.types.vision import Image as Image
    from mjtactile.export.effective_camera import EffectiveCamera as EffectiveCamera
    from mjtactile.export.effective_camera import effective_camera as effective_camera
    from mjtactile.export.live_view import LiveView as LiveView
    from mjtactile.plugin.attach import AttachedSensor as AttachedSensor
    from mjtactile.plugin.attach import attach as attach
    from mjtactile.plugin.sim_finger import SimFinger as SimFinger
    from mjtactile.plugin.sim_finger import step as step
    from mjtactile.quasistatic.membrane import QuasistaticMembrane as QuasistaticMembrane
    from mjtactile.quasistatic.obstacles import Obstacle as Obstacle
    from mjtactile.quasistatic.sensitivities import SolutionSensitivities as SolutionSensitivities
    from mjtactile.quasistatic.solution import MembraneSolution as MembraneSolution
    from mjtactile.recording.observer import Observer as Observer
    from mjtactile.recording.policy_data import PolicyData as PolicyData
    from mjtactile.recording.policy_data import policy_data as policy_data
    from mjtactile.recording.reader import Recording as Recording
    from mjtactile.recording.reader import load_recording as load_recording
    from mjtactile.recording.writer import Recorder as Recorder
    from mjtactile.rig.file import load_rig_file as load_rig_file
    from mjtactile.rig.finger import Finger as Finger
    from mjtactile.rig.finger import Rig as Rig
    from mjtactile.rig.registry import build_rig as build_rig
    from mjtactile.rig.registry import rig_names as rig_names
    from mjtactile.rig.scenario import load_scenario as load_scenario
    from mjtactile.rig.scenario import resolve_scenario as resolve_scenario
    from mjtactile.runtime.controller import load_controller as load_controller
    from mjtactile.runtime.session import Session as Session
    from mjtactile.runtime.session import open_session as open_session
    from mjtactile.sensing.force.from_surface import RestSurface as RestSurface
    from mjtactile.sensing.force.from_surface import SurfaceForce as SurfaceForce
    from mjtactile.sensing.force.from_surface import (
        estimate_force_from_surface as estimate_force_from_surface,
    )
    from mjtactile.sensing.pipeline import SensingPipeline as SensingPipeline
    from mjtactile.sensing.pose.circles_from_images import circles_to_records as circles_to_records
    from mjtactile.sensing.pose.circles_from_images import detect_circles as detect_circles
    from mjtactile.sensing.pose.dot_tracking import TrackedCircles as TrackedCircles
    from mjtactile.sensing.pose.dot_tracking import track_circles as track_circles
    from mjtactile.sensing.stateful_pipeline import StatefulPipeline as StatefulPipeline
    from mjtactile.sim.attach import configure_options as configure_options

_HOMES = {
    "core.calibration": ("Calibration", "load_calibration"),
    "core.calibration_parts": ("LensCalibration", "CalibrationMetadata"),
    "core.design": ("SensorDesign", "load_sensor"),
    "core.errors": (
        "ControllerError",
        "DeviceError",
        "InputError",
        "Interrupted",
        "MjtactileError",
        "SimulationError",
    ),
    "core.optics": ("Camera",),
    "core.scaled_clock": ("monotonic",),
    "core.policy": (
        "action_from_commands",
        "command_from_action",
        "policy_observation_names",
        "policy_observation",
    ),
    "core.policy_file": ("Policy", "load_policy", "save_policy"),
    "core.scenario": ("Scenario",),
    "core.types.command": ("Command",),
    "core.types.control": ("Observation",),
    "core.types.devices": ("GripperState", "ValveState"),
    "core.types.touch": ("Touch",),
    "core.types.vision": ("Image",),
    "core.types.contact_shape": ("ContactShape",),
    "export.effective_camera": ("EffectiveCamera", "effective_camera"),
    "export.live_view": ("LiveView",),
    "quasistatic.obstacles": ("Obstacle",),
    "quasistatic.sensitivities": ("SolutionSensitivities",),
    "quasistatic.membrane": ("QuasistaticMembrane",),
    "quasistatic.solution": ("MembraneSolution",),
    "plugin.attach": ("AttachedSensor", "attach"),
    "plugin.sim_finger": ("SimFinger", "step"),
    "recording.observer": ("Observer",),
    "recording.policy_data": ("PolicyData", "policy_data"),
    "recording.reader": ("Recording", "load_recording"),
    "recording.writer": ("Recorder",),
    "rig.file": ("load_rig_file",),
    "rig.finger": ("Finger", "Rig"),
    "rig.registry": ("build_rig", "rig_names"),
    "rig.scenario": ("resolve_scenario", "load_scenario"),
    "runtime.controller": ("load_controller",),
    "runtime.session": ("Session", "open_session"),
    "sensing.pipeline": ("SensingPipeline",),
    "sensing.force.from_surface": ("RestSurface", "SurfaceForce", "estimate_force_from_surface"),
    "sensing.stateful_pipeline": ("StatefulPipeline",),
    "sensing.pose.circles_from_images": ("detect_circles", "circles_to_records"),
    "sensing.pose.dot_tracking": ("TrackedCircles", "track_circles"),
    "sim.attach": ("configure_options",),
}
_HOME = {name: f"mjtactile.{module}" for module, names in _HOMES.items() for name in names}
__all__ = list(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first requested."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if not platform_support.is_supported():
        raise ImportError(platform_support.REFUSAL)
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value  # cached: later accesses skip `__getattr__`
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
