"""mjtactile: a vision-based membrane touch sensor for MuJoCo, and a gripper that holds fragile
things with it.

What a user needs is here and, for MuJoCo Studio, in `mjtactile.studio`; nothing else is public.
Names are imported when they are first used: a rig without a simulator needs no mujoco, and one
without a camera no OpenCV.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mjtactile.core import system

if TYPE_CHECKING:
    from mjtactile.core.calibration import Calibration as Calibration
    from mjtactile.core.calibration import load_calibration as load_calibration
    from mjtactile.core.calibration_parts import Lens as Lens
    from mjtactile.core.calibration_parts import Stamp as Stamp
    from mjtactile.core.design import SensorDesign as SensorDesign
    from mjtactile.core.design import load_sensor as load_sensor
    from mjtactile.core.errors import ControllerError as ControllerError
    from mjtactile.core.errors import DeviceError as DeviceError
    from mjtactile.core.errors import InputError as InputError
    from mjtactile.core.errors import Interrupted as Interrupted
    from mjtactile.core.errors import MjtactileError as MjtactileError
    from mjtactile.core.errors import SimulationError as SimulationError
    from mjtactile.core.optics import Camera as Camera
    from mjtactile.core.pace import monotonic as monotonic
    from mjtactile.core.policy import policy_action as policy_action
    from mjtactile.core.policy import policy_command as policy_command
    from mjtactile.core.policy import policy_names as policy_names
    from mjtactile.core.policy import policy_vector as policy_vector
    from mjtactile.core.scenario import Scenario as Scenario
    from mjtactile.core.types.control import Command as Command
    from mjtactile.core.types.control import Observation as Observation
    from mjtactile.core.types.devices import GripperState as GripperState
    from mjtactile.core.types.devices import ValveState as ValveState
    from mjtactile.core.types.felt import Touch as Touch
    from mjtactile.core.types.seen import Image as Image
    from mjtactile.core.types.shape import FeltShape as FeltShape
    from mjtactile.export.live import LiveView as LiveView
    from mjtactile.film.bodies import Obstacle as Obstacle
    from mjtactile.film.derivatives import FilmDerivatives as FilmDerivatives
    from mjtactile.film.film import Film as Film
    from mjtactile.film.state import FilmState as FilmState
    from mjtactile.plugin.mount import Mount as Mount
    from mjtactile.plugin.mount import attach as attach
    from mjtactile.plugin.sim_finger import SimFinger as SimFinger
    from mjtactile.plugin.sim_finger import step as step
    from mjtactile.recording.observer import Observer as Observer
    from mjtactile.recording.reader import Recording as Recording
    from mjtactile.recording.reader import load_recording as load_recording
    from mjtactile.recording.writer import Recorder as Recorder
    from mjtactile.rig.file import load_rig_file as load_rig_file
    from mjtactile.rig.finger import Finger as Finger
    from mjtactile.rig.finger import Rig as Rig
    from mjtactile.rig.registry import build_rig as build_rig
    from mjtactile.rig.registry import rig_names as rig_names
    from mjtactile.rig.scenario import complete_scenario as complete_scenario
    from mjtactile.rig.scenario import load_scenario as load_scenario
    from mjtactile.run.controller import load_controller as load_controller
    from mjtactile.run.session import Session as Session
    from mjtactile.run.session import open_session as open_session
    from mjtactile.sensing.chain import Chain as Chain
    from mjtactile.sensing.force.of_surface import RestSurface as RestSurface
    from mjtactile.sensing.force.of_surface import SurfaceForce as SurfaceForce
    from mjtactile.sensing.force.of_surface import force_of_surface as force_of_surface
    from mjtactile.sensing.perception import Perception as Perception
    from mjtactile.sensing.pose.locate import find_circles as find_circles
    from mjtactile.sensing.pose.locate import marker_records as marker_records
    from mjtactile.sensing.pose.skin import TrackedCircles as TrackedCircles
    from mjtactile.sensing.pose.skin import track_circles as track_circles
    from mjtactile.sim.attach import recommend_options as recommend_options

_HOMES = {
    "core.calibration": ("Calibration", "load_calibration"),
    "core.calibration_parts": ("Lens", "Stamp"),
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
    "core.pace": ("monotonic",),
    "core.policy": ("policy_action", "policy_command", "policy_names", "policy_vector"),
    "core.scenario": ("Scenario",),
    "core.types.control": ("Command", "Observation"),
    "core.types.devices": ("GripperState", "ValveState"),
    "core.types.felt": ("Touch",),
    "core.types.seen": ("Image",),
    "core.types.shape": ("FeltShape",),
    "export.live": ("LiveView",),
    "film.bodies": ("Obstacle",),
    "film.derivatives": ("FilmDerivatives",),
    "film.film": ("Film",),
    "film.state": ("FilmState",),
    "plugin.mount": ("Mount", "attach"),
    "plugin.sim_finger": ("SimFinger", "step"),
    "recording.observer": ("Observer",),
    "recording.reader": ("Recording", "load_recording"),
    "recording.writer": ("Recorder",),
    "rig.file": ("load_rig_file",),
    "rig.finger": ("Finger", "Rig"),
    "rig.registry": ("build_rig", "rig_names"),
    "rig.scenario": ("complete_scenario", "load_scenario"),
    "run.controller": ("load_controller",),
    "run.session": ("Session", "open_session"),
    "sensing.chain": ("Chain",),
    "sensing.force.of_surface": ("RestSurface", "SurfaceForce", "force_of_surface"),
    "sensing.perception": ("Perception",),
    "sensing.pose.locate": ("find_circles", "marker_records"),
    "sensing.pose.skin": ("TrackedCircles", "track_circles"),
    "sim.attach": ("recommend_options",),
}
_HOME = {name: f"mjtactile.{module}" for module, names in _HOMES.items() for name in names}
__all__ = list(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if not system.is_supported():
        raise ImportError(system.REFUSAL)
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value  # the next time it is found at once
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
