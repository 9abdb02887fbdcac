"""`PressWorld`: one sensor on a fixed base and an indenter driven into it, as in the paper."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import mujoco
import numpy as np

from mjtactile.core import foreign_file
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.flags import Cadence
from mjtactile.sim.attach import attach_membrane, configure_options
from mjtactile.sim.finite_model import require_finite
from mjtactile.sim.scenes.meshes import SUFFIXES, add_solid, convex_parts, load_solid
from mjtactile.sim.scenes.mjcf import read_mjcf, take_options
from mjtactile.sim.scenes.world import World
from mjtactile.sim.sensor.effect_switches import PHYSICS
from mjtactile.sim.sensor.mesh import MarkerInterpolator
from mjtactile.sim.sensor.mesh_sensor import TactileSensor

SHAPES = ("sphere:R_mm", "cylinder:R_mm", "box:A_mm", "FILE.stl", "FILE.obj", "FILE.xml")
_LENGTH = 0.03  # length of a cylinder along its axis, m
_CLEARANCE = 0.002  # initial height of the indenter above first touch, m
_AWAY = 0.05  # minimum retracted height of the drive above the world's origin, m
_CLEAR = 0.01  # minimum initial distance of the indenter from the flat membrane, m: above any bulge
# settling speed, m/s: by the solver's tolerance, vertices in contact keep moving this fast; the
# force changes by 0.1 %
_STILL = 2e-4
# time and relative range of a steady force, s
_STEADY_TIME = 0.2
_STEADY_FRACTION = 5e-3
_SHEAR_SPEED = 2e-3  # speed of a load with shear, m/s
_FILES = {**dict.fromkeys(SUFFIXES, "mesh"), ".xml": "model"}
# stiffness, N/m, and mass, kg, of the drive: deflection of 5 um at 1 N
_STIFFNESS = 2e5
_MASS = 0.2
# solimp of the frame's contacts: the drive's 200 N per mm penetrate by less than 0.1 mm
_HARD = [0.9999, 0.9999, 0.001, 0.5, 2.0]
_FRAME_FIRST = 1e-4  # refused height of the touch of the frame above that of the membrane, m


class Indentations(Protocol):
    """Indenter of a `PressWorld`."""

    def add_to(self, spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None: ...


@dataclass(frozen=True)
class Indenter:
    """Rigid indenter shape.

    `size` m is the radius of a "sphere" or "cylinder" (30 mm long, axis along z, end face down), or
    the edge of a "box". `path` is the file of a "mesh" (STL or OBJ, in mm) or "model" (MJCF).
    """

    kind: str
    size: float = 0.0
    path: Path | None = None

    @classmethod
    def parse(cls, text: str) -> Indenter:
        """Read "sphere:8", "cylinder:5", "box:10" or a file of `_FILES`. Raises InputError."""
        kind, _, number = text.partition(":")
        path = foreign_file.user_path(text)
        if path.suffix.lower() in _FILES:
            if not foreign_file.is_file(path):
                raise InputError("no such file", source=path, field="--indenter", choices=SHAPES)
            return cls(_FILES[path.suffix.lower()], path=path)
        try:
            size = float(number) * 1e-3
        except ValueError:
            size = np.nan
        if kind not in ("sphere", "cylinder", "box") or not 1e-5 <= size <= 1:
            raise InputError(
                f"{text!r} is not an indenter of 0.01 to 1000 mm",
                field="--indenter",
                choices=SHAPES,
            )
        return cls(kind, size)

    def add_to(self, spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
        """Add the indenter's geoms, centered on `body`. Raises InputError for a bad model."""
        if self.kind == "model":
            self._attach(spec, body)
            return
        if self.kind == "mesh" and self.path is not None:
            parts = convex_parts(load_solid(self.path))
            for geom in add_solid(spec, body, "indenter", parts):
                geom.mass = _MASS / len(parts)
            return
        geom = body.add_geom(name="indenter", mass=_MASS, rgba=[0.3, 0.45, 0.7, 1.0])
        geom.type = getattr(mujoco.mjtGeom, f"mjGEOM_{self.kind.upper()}")
        half = self.size / 2
        geom.size = {
            "sphere": [self.size, 0, 0],
            "cylinder": [self.size, _LENGTH / 2, 0],
            "box": [half] * 3,
        }[self.kind]

    def _attach(self, spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
        model = read_mjcf(Path(str(self.path)), field="--indenter")
        if model.joints or not model.geoms:
            raise InputError(
                "an indenter consists of at least one geom, and has no joints",
                source=self.path,
                field="--indenter",
            )
        for geom in model.geoms:
            geom.mass = _MASS / len(model.geoms)
        take_options(model, spec)
        spec.attach(model, frame=body.add_frame(), prefix="indenter/")


class PressWorld(World):
    """Indentation test: the sensor faces up, and the indenter moves down along -z and along x.

    S is the world frame. `at` is (x, y) m in S, `tilt` rad about y. Depths are relative to the
    first touch of the membrane in its shape at that time. Sensor and drive stand on a carrier,
    rotated by `mount` (rotation vector, rad) and shaken along its x with `shake` (amplitude m,
    frequency Hz).
    """

    def __init__(
        self,
        sensor: SensorDesign | str | Path,
        indenter: Indentations,
        *,
        at: tuple[float, float] = (0.0, 0.0),
        tilt: float = 0.0,
        timestep: float = 4e-3,
        mesh: tuple[int, int] | None = None,
        contact: str = "auto",
        effects: frozenset[str] = PHYSICS,
        mount: tuple[float, float, float] = (0.0, 0.0, 0.0),
        shake: tuple[float, float] = (0.0, 0.0),
    ):
        spec = mujoco.MjSpec()
        configure_options(spec, timestep)
        # a stiff drive shows the solver's noise: 10 mN at the 1e-7 of a grasp, 1 mN here
        spec.option.tolerance = 1e-9
        carrier = _add_carrier(spec, mount)
        attachment = attach_membrane(
            spec, sensor, site="base", prefix="sensor/", mesh=mesh, contact=contact, effects=effects
        )
        self.design = attachment.design
        self.start_height = max(_AWAY, _extent(indenter) + _CLEAR)
        body = carrier.add_body(name="indenter", pos=[*at, self.start_height], gravcomp=1.0)
        for axis, direction in (("x", [1, 0, 0]), ("z", [0, 0, 1])):
            body.add_joint(name=f"drive_{axis}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=direction)
            drive = spec.add_actuator(
                name=f"drive_{axis}", target=f"drive_{axis}", trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            drive.set_to_position(kp=_STIFFNESS, kv=2 * np.sqrt(_STIFFNESS * _MASS))
        holder = body.add_body(
            name="holder", gravcomp=1.0, quat=[np.cos(tilt / 2), 0, np.sin(tilt / 2), 0]
        )
        others = {geom.name for geom in spec.geoms}
        indenter.add_to(spec, holder)
        _collide_with_frame(spec, others)
        super().__init__(spec, [attachment])
        self._x, self._z = (self.model.actuator(f"drive_{axis}").id for axis in "xz")
        self._joints = [self.model.joint(f"drive_{axis}").qposadr[0] for axis in "xz"]
        self._geoms = np.flatnonzero(
            np.isin(self.model.geom_bodyid, _subtree(self.model, self.model.body("indenter").id))
        )
        self._touch_height = 0.0
        self._frame_height = 0.0
        self._surface = MarkerInterpolator(self.sensors[0].mesh, _membrane_points(self.design, at))
        self._shake = shake
        self._carrier = self.model.actuator("carrier").id

    def inflate(self, gauge_pressure: float, *, seal: bool) -> bool:
        """Inflate to `gauge_pressure` Pa, close the valve if `seal`, find first touch; True if
        settled."""
        sensor = self.sensors[0]
        self.lift_off()
        sensor.open_valve(gauge_pressure)
        settled = self.settle()
        if seal:
            sensor.close_valve()
        self._find_touch()
        return settled

    def press(self, depth: float, shear: float = 0.0, speed: float = 0.02) -> bool:
        """Drive to `depth` m below first touch and `shear` m along x; return True if it settled.

        Shear is slow: the membrane's damping would load the contact's edge and let it slip. Raises
        InputError if the indenter would touch the frame before the membrane.
        """
        if self._frame_height > self._touch_height + _FRAME_FIRST:
            raise InputError(
                "touches the frame before the membrane, by "
                f"{1e3 * (self._frame_height - self._touch_height):.2g} mm: use a smaller one, "
                "less tilt, or a position nearer to the center",
                source="press",
                field="indenter",
            )
        moves = abs(shear - float(self.data.ctrl[self._x])) > 0
        self.drive(depth, shear, min(speed, _SHEAR_SPEED) if moves else speed)
        return self.settle(speed=_STILL, loaded=True)

    def drive(self, depth: float, shear: float = 0.0, speed: float = 0.02) -> None:
        """Drive like `press`, without settling."""
        start = self.data.ctrl[[self._x, self._z]]
        goal = np.array([shear, self._touch_height - depth])
        count = max(1, int(np.ceil(np.abs(goal - start).max() / (speed * self.timestep) - 1e-9)))
        for part in np.linspace(0, 1, count + 1)[1:]:
            for actuator, value in zip(
                (self._x, self._z), start + part * (goal - start), strict=True
            ):
                self.set_control(actuator, value)
            self.step()

    def settle(self, time_limit: float = 1.0, speed: float = 2e-5, *, loaded: bool = False) -> bool:
        """Step until all speeds stay below `speed` m/s for 20 ms; return False if not in time.

        A load whose force has been steady counts as settled, too: single vertices at the edge of a
        contact may keep moving.
        """
        if self._shake[0]:
            self.step(round(0.2 / self.timestep))
            return True
        needed = round(0.02 / self.timestep) + 1
        still = 0
        forces = deque[float](maxlen=round(_STEADY_TIME / self.timestep))
        for _ in range(round(time_limit / self.timestep)):
            self.step()
            forces.append(float(self.drive_force[2]))
            still = still + 1 if np.abs(self.data.qvel).max() < speed else 0
            if still >= needed:
                break
        range_ = float(np.ptp(forces))
        is_steady = range_ < _STEADY_FRACTION * abs(forces[-1])
        if still >= needed or (loaded and is_steady):
            self.update_flags({}, {Cadence.SETTLING})
            return True
        reason = (
            f"the membrane did not come to rest in {time_limit:g} s: forces are those of a "
            f"moving membrane, whose load varies by {range_:.2g} N"
        )
        self.update_flags({"unsettled": reason}, {Cadence.SETTLING})
        return False

    def _before_step(self) -> None:
        amplitude, frequency = self._shake
        if amplitude:
            self.set_control(self._carrier, amplitude * np.sin(2 * np.pi * frequency * self.time))

    @property
    def depth(self) -> float:
        """Actual depth of the indenter below first touch, m."""
        return self._touch_height - float(self.data.qpos[self._joints[1]])

    @property
    def drive_force(self) -> np.ndarray:
        """Force (3,) N of the drive on the indenter, frame S, as of a load cell."""
        return np.array([self.data.actuator_force[self._x], 0.0, self.data.actuator_force[self._z]])

    def lift_off(self) -> None:
        """Move the indenter to a position without contact."""
        self._place(_AWAY)

    def _find_touch(self) -> None:
        """Lower the indenter onto the smooth membrane of the markers, then raise it by a clearance.

        Raises InputError when the indenter would slip between vertices.
        """
        sensor = self.sensors[0]
        slips = (
            isinstance(sensor, TactileSensor)
            and sensor.contact == "vertices"
            and np.isfinite(sensor.missed[0])
        )
        if slips:
            raise InputError(
                "slips between the membrane's vertices; use contact 'elements'",
                source="press",
                field="indenter",
            )
        points = self._surface.marker_poses(sensor.p_SV)[0]
        R_WS = self.data.xmat[sensor.body_id].reshape(3, 3).copy()
        p_WS = self.data.xpos[sensor.body_id].copy()
        self._touch_height = self._lowered(lambda: self._gap(points @ R_WS.T + p_WS))
        self._frame_height = self._lowered(self._frame_gap)
        self._place(max(self._touch_height, self._frame_height) + _CLEARANCE)

    def _lowered(self, gap: Callable[[], float]) -> float:
        """Lower the indenter by its `gap`, m, until it is 0; return the height, m."""
        height = _AWAY
        for _ in range(50):
            self._place(height)
            distance = gap()
            height -= distance
            if abs(distance) < 1e-7:
                break
        return height

    def _gap(self, points: np.ndarray) -> float:
        """Return the minimum distance of the indenter from membrane spheres at `points` (n, 3),
        m."""
        probe = int(self.sensors[0].vertex_geom_ids[0])
        gaps = []
        for point in points:
            self.data.geom_xpos[probe] = point
            gaps.append(self._distance(probe))
        return min(gaps)

    def _frame_gap(self) -> float:
        """Return the minimum distance of the indenter from the frame, m."""
        return min(self._distance(int(wall)) for wall in self.sensors[0].housing_geom_ids)

    def _distance(self, geom: int) -> float:
        """Return the distance of the indenter from a geom, at most 0.5 m; negative: penetration."""
        return min(
            mujoco.mj_geomDistance(self.model, self.data, geom, int(part), 0.5, None)
            for part in self._geoms
        )

    def _place(self, height: float) -> None:
        self.data.qpos[self._joints[1]] = height
        self.set_control(self._z, height)
        mujoco.mj_forward(self.model, self.data)


def _collide_with_frame(spec: mujoco.MjSpec, others: set[str]) -> None:
    """Add contact pairs of the sensor's housing, which is among the geoms `others`, and the
    indenter's geoms. MuJoCo ignores contacts of a body with the one that carries it."""
    # sorted: the order of a set of names, and so that of the contacts, differs between processes
    housing = sorted(name for name in others if name.startswith("sensor/housing"))
    geoms = [geom for geom in spec.geoms if geom.name not in others]
    for number, geom in enumerate(geoms):
        if not (geom.contype or geom.conaffinity):
            continue
        geom.name = geom.name or f"indenter part {number}"
        for wall in housing:
            pair = spec.add_pair(geomname1=geom.name, geomname2=wall)
            pair.solimp = _HARD


def _extent(indenter: Indentations) -> float:
    """Return the distance of the indenter's farthest point from its origin, m, or an upper bound of
    it."""
    spec = mujoco.MjSpec()
    indenter.add_to(spec, spec.worldbody.add_body())
    try:
        model = spec.compile()
    except ValueError as error:
        message = f"does not compile: {' '.join(str(error).split())}"
        raise InputError(message, field="--indenter") from error
    require_finite(model, "indenter")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return float((np.linalg.norm(data.geom_xpos, axis=1) + model.geom_rbound).max())


def _subtree(model: mujoco.MjModel, root: int) -> list[int]:
    """Return a MuJoCo body and all its descendants; parents come first in a model."""
    bodies = [root]
    for body in range(root + 1, model.nbody):
        if model.body_parentid[body] in bodies:
            bodies.append(body)
    return bodies


def _membrane_points(design: SensorDesign, at: tuple[float, float]) -> np.ndarray:
    """Return points (n, 3) m of the flat membrane, 0.6 mm apart, one of them at `at`."""
    frame = design.frame
    axes = [np.arange(-0.5 * side, 0.5 * side, 6e-4) for side in (frame.length, frame.width)]
    x, y = (
        axis + (coordinate - axis[np.argmin(np.abs(axis - coordinate))])
        for axis, coordinate in zip(axes, at, strict=True)
    )
    points = np.stack([*np.meshgrid(x, y), np.zeros((len(y), len(x)))], axis=-1).reshape(-1, 3)
    if frame.outline is not None:  # same margin as on rectangles
        return points[frame.inside(points[:, :2] / 0.98) > 0]
    inside = np.abs(points[:, :2] / (frame.length, frame.width))
    return points[inside.max(axis=1) < 0.49]


def _add_carrier(spec: mujoco.MjSpec, mount: tuple[float, float, float]) -> mujoco.MjsBody:
    """Add a heavy MuJoCo body on a stiff slide that carries the sensor's site "base"."""
    angle = float(np.linalg.norm(mount))
    axis = np.asarray(mount) / angle if angle else np.array([0.0, 0.0, 1.0])
    carrier = spec.worldbody.add_body(
        name="carrier", quat=[np.cos(angle / 2), *(np.sin(angle / 2) * axis)], gravcomp=1.0
    )
    carrier.mass = 1.0
    carrier.inertia = [1e-3] * 3
    carrier.explicitinertial = True
    carrier.add_joint(name="carrier", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0])
    drive = spec.add_actuator(name="carrier", target="carrier", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    drive.set_to_position(kp=_STIFFNESS, kv=2 * np.sqrt(_STIFFNESS))
    carrier.add_site(name="base")
    return carrier
