"""`World`: a compiled scene with its sensors, stepped with every step checked."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence

import mujoco
import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.flags import Cadence, Flag, Reasons
from mjtactile.core.types import Array
from mjtactile.sim.attach import Attachment
from mjtactile.sim.batched_quasistatic_step import MAX_STEPS, QuasistaticStepper
from mjtactile.sim.checked_stepper import Stepper
from mjtactile.sim.mujoco_log import route_warnings
from mjtactile.sim.scenes.objects import PREFIX, ObjectModel
from mjtactile.sim.sensor.sensor_types import AnySensor


class World:
    """Model and data of a scene with attached sensors. `step` raises SimulationError on
    divergence."""

    def __init__(
        self,
        spec: mujoco.MjSpec,
        attachments: Sequence[Attachment],
        place: Callable[[mujoco.MjModel, mujoco.MjData], None] = lambda model, data: None,
    ):
        """Compile the scene; `place` sets the initial state before sensors are bound."""
        route_warnings()
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        try:
            self.model = spec.compile()
        except ValueError as error:
            raise InputError(
                f"the scene does not compile: {' '.join(str(error).split())}", source="scene"
            ) from error
        self.data = mujoco.MjData(self.model)
        place(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)
        self.sensors: tuple[AnySensor, ...] = tuple(
            a.bind(self.model, self.data) for a in attachments
        )
        self._stepper = Stepper(self.model, self.data, self.sensors)
        self._after_step: list[Callable[[], None]] = []
        self._after_step_batch: list[Callable[[], None]] = []
        self._dues: list[Callable[[], float]] = []
        self._batches: QuasistaticStepper | None = None
        self.batch_forces: Array | None = None
        """Wrench (n, sensors, 6) on each sensor in each of the last n steps.

        Set only where the steps ran in one call.
        """
        self._moves = type(self)._before_step is not World._before_step

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return float(self.data.time)

    @property
    def timestep(self) -> float:
        return float(self.model.opt.timestep)

    @property
    def kinetic_energy(self) -> float:
        """Kinetic energy with each joint's inertia at the reference pose, J."""
        return float(0.5 * np.asarray(self.model.dof_M0) @ np.square(self.data.qvel))

    def set_control(self, actuator: int, value: float) -> None:
        """Set one actuator's control. Raises InputError when it is not finite."""
        if not np.isfinite(value):
            raise InputError(
                f"{value!r} is not a finite control value",
                source="World",
                field=self.model.actuator(actuator).name,
            )
        self.data.ctrl[actuator] = value

    @property
    def flags(self) -> dict[str, Flag]:
        """Flags of reduced accuracy so far, by kind."""
        return self._stepper.flags

    def update_flags(self, reasons: Reasons, checked: Collection[Cadence] = ()) -> None:
        """Raise the flags in `reasons`, and clear the other flags of the cadences `checked`."""
        self._stepper.update_flags(reasons, checked)

    @property
    def contact_counts(self) -> tuple[int, int]:
        """Numbers of geoms near the membranes and of contact points on them."""
        return self._stepper.contact_counts

    @property
    def step_count(self) -> int:
        return self._stepper.step_count

    def step(self, count: int = 1) -> None:
        """Advance by `count` time steps. Raises SimulationError if the state is no longer valid."""
        watched = self._after_step or self._after_step_batch
        if not (self.sensors or watched or self._moves):  # no work between the steps
            mujoco.mj_step(self.model, self.data, count)
            self._stepper.after_step(count)
            return
        while count > 0:
            count -= self._advance(count)

    def _advance(self, count: int) -> int:
        """Run up to `count` steps in one kernel call if possible, else one. Return their number."""
        batches = self._batches
        if batches is None or self._after_step or not batches.is_ready():
            self.batch_forces = None
            self._before_step()
            self._stepper.step()
            done = 1
        else:
            maximum = min(count, MAX_STEPS, self._stepper.steps_to_check, self._until_due())
            self._write_goals(batches)
            done, unsolved, self.batch_forces = batches.run(
                maximum, not self._stepper.is_speed_flagged
            )
            self._read_goals(batches)
            self._stepper.after_step(done, unsolved)
        for call in (*self._after_step, *self._after_step_batch):
            call()
        return done

    def _until_due(self) -> int:
        """Return the number of steps, at least one, until a callback is due."""
        due = min((due() for due in self._dues), default=math.inf)
        if math.isinf(due):
            return MAX_STEPS
        return max(1, math.ceil((due - self.time) / self.timestep - 1e-9))

    def _write_goals(self, batches: QuasistaticStepper) -> None:
        """Write goals and limits to `batches`. A hook of worlds that move their controls."""

    def _read_goals(self, batches: QuasistaticStepper) -> None:
        """Read the goals that `batches` has reached. A hook of worlds that move their controls."""

    def after_each_step(self, call: Callable[[], None]) -> None:
        """Register `call()` to run after every later step."""
        self._after_step.append(call)

    def after_each_step_batch(
        self, call: Callable[[], None], due: Callable[[], float] | None = None
    ) -> None:
        """Register `call` to run after every batch of steps, at least every 20 ms.

        `due` returns the latest time of the next call, s. It is evaluated before each batch.
        """
        self._after_step_batch.append(call)
        if due is not None:
            self._dues.append(due)

    def marker_poses(self, sensor: int) -> tuple[Array, Array]:
        """Return marker centers (N, 3) m and outward normals (N, 3) of one sensor in S."""
        return self.sensors[sensor].marker_poses()

    def _before_step(self) -> None:
        """Move controls before a step. A hook of worlds that move their controls."""

    def _watch(self, watcher: Callable[[], Reasons]) -> None:
        """Register `watcher`; its flags are collected at each check of the state."""
        self._stepper.watchers.append(watcher)


def touched_by_sensors(world: World) -> set[tuple[str, str, str]]:
    """Return sensor prefix, MuJoCo body ("": a flex) and geom of contacts with sensors."""
    found = set()
    for contact in world.data.contact:
        if contact.exclude:  # near, but not touching
            continue
        sides = list(zip(contact.geom, contact.flex, strict=True))
        for side, other in (sides, sides[::-1]):
            owner = next(
                (sensor for sensor in world.sensors if _is_part(world, sensor, *side)), None
            )
            if owner is not None and not any(
                _is_part(world, sensor, *other) for sensor in world.sensors
            ):
                found.add((owner.prefix, *_names(world, *other)))
    return found


def require_clear(world: World, grasped: ObjectModel, opening: float) -> None:
    """Raise InputError for an object that touches a sensor in the initial state."""
    if not any(not body or body.startswith(PREFIX) for _, body, _ in touched_by_sensors(world)):
        return
    text = f"touches a sensor before the jaws close: they open to {1e3 * opening:.0f} mm"
    if width := _width(world):
        text += (
            f", and its bounding box is {1e3 * width:.0f} mm wide in their direction (files are in "
            "m), or not centered"
        )
    if grasped.turn > 0:
        text += "; the seed rotates it about z, which rotation_deg in its file limits"
    raise InputError(text, source=grasped.path, field="object")


def _width(world: World) -> float:
    """Return the extent of the object's bounding boxes along the closing direction, m; 0 of a
    flex."""
    model = world.model
    geoms = np.flatnonzero(model.body_rootid[model.geom_bodyid] == model.body(PREFIX + "object").id)
    if not len(geoms):
        return 0.0
    closing = world.data.xmat[world.sensors[0].body_id].reshape(3, 3)[:, 2]
    along = closing @ world.data.geom_xmat[geoms].reshape(-1, 3, 3)
    center, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    middle = world.data.geom_xpos[geoms] @ closing + (along * center).sum(axis=1)
    reach = (np.abs(along) * half).sum(axis=1)
    return float((middle + reach).max() - (middle - reach).min())


def _is_part(world: World, sensor: AnySensor, geom: int, flex: int) -> bool:
    """Return True if a side of a contact is the sensor's housing or membrane."""
    if geom < 0:
        return flex == sensor.flex_id
    body = int(world.model.geom_bodyid[geom])
    return sensor.body_id in (body, int(world.model.body_parentid[body]))


def _names(world: World, geom: int, flex: int) -> tuple[str, str]:
    if geom < 0:
        return "", f"flex {flex}"
    body = world.model.body(int(world.model.geom_bodyid[geom])).name
    return body or "world", world.model.geom(int(geom)).name or f"geom of {body or 'world'}"
