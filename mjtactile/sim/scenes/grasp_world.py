"""`GraspWorld`: a simulated rig over a table, with an object to grasp between its fingers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.flags import Reasons
from mjtactile.core.gripper_path import GripperPath
from mjtactile.core.task import SampledDisturbance
from mjtactile.rig.file import load_sim_rig
from mjtactile.rig.simulated import SimRigFile
from mjtactile.sim.scenes.gripper_world import DEFAULT_TIMESTEP, GripperWorld
from mjtactile.sim.scenes.initial_state import Start, path_axes
from mjtactile.sim.scenes.objects import PREFIX, ObjectModel, add_object, add_supports, load_object
from mjtactile.sim.scenes.second_object import add_second_object, second_object
from mjtactile.sim.scenes.strain import SoftSolid, soft_flex
from mjtactile.sim.scenes.world import require_clear
from mjtactile.sim.sensor.effect_switches import PHYSICS

_STRAINED = 0.2
"""Compression from which rubber is stiffer than linear elements by 27 % and more."""

_APART = 0.1
"""Minimum distance, m, of a place with its own copy of the object's stand."""

_OBLIQUE = 5.0  # degrees; membranes follow smaller angles


class GraspWorld(GripperWorld):
    """Fingers of `rig` around an object that stands under the gripper.

    In its file, the object is gripped along x. It is rotated to the closing direction of the first
    finger.
    """

    def __init__(
        self,
        sensor: SensorDesign | str | Path = "dense",
        grasped: ObjectModel | str | Path = "egg",
        *,
        rig: SimRigFile | str | Path = "sim",
        timestep: float = DEFAULT_TIMESTEP,
        mesh: tuple[int, int] | None = None,
        object_pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
        opening: float | None = None,
        effects: frozenset[str] = PHYSICS,
        as_built_designs: Sequence[SensorDesign] = (),
        path: GripperPath | None = None,
        stacked: SampledDisturbance | None = None,
    ):
        """Create the scene.

        `object_pose` is x, y (m) and yaw (rad) of the object's file on the table, relative to the
        gripper. `opening` m is the initial jaw opening (default: the rig file's).
        `as_built_designs` are the designs of the fingers, if they differ from `sensor`. `path` is
        that of the task, `stacked` its second object.
        """
        self.design = load_sensor(sensor)
        self.object = grasped if isinstance(grasped, ObjectModel) else load_object(grasped)
        self.as_built_designs = tuple(as_built_designs)
        rig = rig if isinstance(rig, SimRigFile) else load_sim_rig(rig)
        designs = self.as_built_designs or finger_designs(rig, self.design)

        def furnish(spec: mujoco.MjSpec, start: Start) -> None:
            centre = start.centre
            add_object(spec, self.object, _pose_at(start, object_pose), height=rig.table_height)
            if path is not None and max(np.abs(path.at(path.end)[:2])) > _APART:
                end = np.append(path.at(path.end)[:2], 0.0) @ path_axes(start)
                x, y, yaw = _pose_at(start, object_pose)
                place = x + float(end[0]), y + float(end[1]), yaw
                add_supports(spec, self.object, place, height=rig.table_height)
            if stacked is not None:
                add_second_object(spec, self.object, stacked, centre)

        super().__init__(
            rig,
            designs,
            self.object.grasp_height,
            timestep=timestep,
            mesh=mesh,
            opening=opening,
            grip=self.object.width,
            effects=effects,
            furnish=furnish,
            path=path,
        )
        material = self.object.flex_material
        if material is None:
            self.solid = None
        else:
            self.solid = SoftSolid(
                self.model, soft_flex(self.model, PREFIX), material.young, material.poisson
            )
        """Elements of a soft object for its strain distribution; used for scoring and for flags."""
        self.second_object = second_object(self.model, self.data)
        """Second object of the task; None without one."""
        self._watch(self._strain_flags)
        require_clear(self, self.object, self.opening)

    def oblique_faces(self) -> str | None:
        """Return a note if the seed rotates the faces of all boxes relative to the fingers."""
        body = self.model.body(PREFIX + "object")
        geoms = range(int(body.geomadr[0]), int(body.geomadr[0] + body.geomnum[0]))
        kinds = {int(self.model.geom_type[geom]) for geom in geoms}
        if kinds != {int(mujoco.mjtGeom.mjGEOM_BOX)} or self.object.turn < math.pi:
            return None
        closing = self.data.xmat[self.sensors[0].body_id].reshape(3, 3)[:, 2]
        axes = self.data.geom_xmat[list(geoms)].reshape(-1, 3, 3)
        cosines = np.abs(np.einsum("gik,i->gk", axes, closing))
        angle = math.degrees(math.acos(min(float(cosines.max()), 1.0)))
        if angle < _OBLIQUE:
            return None
        return (
            f"{self.object.name}: the seed rotates its faces by {angle:.0f} degrees relative to "
            "the fingers, which then hold its edges; rotation_deg in its file limits this"
        )

    def _strain_flags(self) -> Reasons:
        """Return a flag if the strain exceeds the range of the object's linear elements."""
        if self.solid is None:
            return {}
        compression = self.solid.strain(self.data).compression
        if compression <= _STRAINED:
            return {}
        return {
            "strain": (
                f"{self.object.name!r} is compressed by up to {compression:.0%}: its elements are "
                f"linear, while rubber is stiffer by a quarter from {_STRAINED:.0%} on; use less "
                "force"
            )
        }

    def _check_clearance(self, tip_height: float, half: float) -> None:
        if tip_height <= half:
            raise InputError(
                f"grasp height {tip_height * 1e3:g} mm is below {half * 1e3:g} mm: the sensors' "
                "frames would hit the table; put the object on a stand",
                source=self.object.path,
                field="grasp_height_m",
            )


def finger_designs(rig: SimRigFile, sensor: SensorDesign) -> tuple[SensorDesign, ...]:
    """Return the sensor of each finger: the rig file's own, or `sensor`."""
    return tuple(
        sensor if finger.sensor is None else load_sensor(finger.sensor) for finger in rig.fingers
    )


def _pose_at(start: Start, pose: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return x, y (m) and yaw (rad) in the world of a pose relative to the gripper."""
    x, y, yaw = pose
    cos = math.cos(start.yaw)
    sin = math.sin(start.yaw)
    centre = start.centre
    return centre[0] + (cos * x - sin * y), centre[1] + (sin * x + cos * y), start.yaw + yaw
