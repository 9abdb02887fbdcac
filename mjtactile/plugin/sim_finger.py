"""`SimFinger`: one sensor in a user's scene, with its membrane and its sensing pipeline."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType

import mujoco
import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.effect_names import Effect
from mjtactile.core.errors import InputError
from mjtactile.core.flags import Flags, merge_flags
from mjtactile.core.not_copyable import NotCopyable
from mjtactile.core.signature_checks import not_below, validated
from mjtactile.core.types import Array, ContactShape, Image, Surface, Touch
from mjtactile.rig.finger import Finger
from mjtactile.runtime.references import take_references
from mjtactile.runtime.uncertain_force_monitor import UncertainForceMonitor
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sensing.pipeline_state import PipelineState
from mjtactile.sensing.settings import DEFAULTS
from mjtactile.sensing.stateful_pipeline import StatefulPipeline
from mjtactile.sim.attach import NEEDED_FLAGS, Attachment, attach_membrane, configure_options
from mjtactile.sim.camera import SimCamera
from mjtactile.sim.checked_stepper import Stepper
from mjtactile.sim.devices import SimClock, SimValve
from mjtactile.sim.fast_step import advance
from mjtactile.sim.finite_model import require_finite
from mjtactile.sim.scenes.world import World
from mjtactile.sim.sensor import carrier_geoms
from mjtactile.sim.sensor.collision_rule import apply_collision_rule, contact_notes
from mjtactile.sim.sensor.contact_loads import membrane_wrench
from mjtactile.sim.sensor.membrane import BODY
from mjtactile.sim.sensor.sensor_types import AnySensor


@dataclass(frozen=True, eq=False)
class Rest:
    """Reference state of a sensor with a sealed chamber and no contact.

    `displacements` (3 k,), m, frame S, are those of the interior mesh vertices. The pipeline's
    `state` holds both references.
    """

    displacements: Array
    gauge_pressure: float
    pipeline: SensingPipeline
    state: PipelineState


@lru_cache(maxsize=64)
def at_rest(
    design: SensorDesign, mesh: tuple[int, int], effects: frozenset[str], seed: int
) -> Rest:
    """Inflate one sensor alone and take its references. Raises DeviceError if that fails."""
    spec = mujoco.MjSpec()
    configure_options(spec)
    spec.option.gravity = [0.0, 0.0, 0.0]
    site = spec.worldbody.add_site()
    attachment = attach_membrane(spec, design, site=site, mesh=mesh, effects=effects)
    world = World(spec, [attachment])
    sensor = world.sensors[0]
    clock = SimClock(world)
    finger = Finger("alone", design, SimCamera(sensor, seed, effects), SimValve(sensor))
    settings = DEFAULTS.for_mesh(design, mesh) if Effect.MESH in effects else DEFAULTS
    perception = StatefulPipeline.of(design, settings=settings)
    flat, rest = take_references([finger], clock)
    perception.measure_flat_reference(flat.images[0])
    perception.measure_rest_reference(rest.images[0], finger.pressure(rest.gauge_pressure[0]))
    clock.close()
    return Rest(sensor.displacements, sensor.gauge_pressure, perception.pipeline, perception.state)


_OPTIONS = (
    "timestep",
    "integrator",
    "solver",
    "cone",
    "jacobian",
    "noslip_iterations",
    "disableflags",
)
"""Options of a model that must not change while sensors are bound."""
OUTPUTS = {"wrench": 6, "pressure": 1, "touching": 1}
"""MuJoCo sensors of type `user` added by `attach`, with their numbers of values."""


@dataclass(frozen=True, eq=False)
class SensorReading:
    """Result of one camera image: `touch` with its age, and the membrane reference `rest`.

    `gauge_pressure`, Pa, and `temperature`, K, are those of the chamber at that time.
    """

    image: Image
    touch: Touch
    rest: Surface | None
    gauge_pressure: float
    temperature: float


class SimFinger(NotCopyable):
    """Sensor in a scene that the user steps: membrane, gas, camera and sensing pipeline.

    It differs from `mjtactile.Finger`, which is part of a rig and is read by a session. `SimFinger`
    processes its own images when they are due, since the user runs the loop. `AttachedSensor.bind`
    creates it, inflated and with its references taken.

    After every step it writes three entries of `data.sensordata`. PREFIXwrench holds 6 values:
    estimated force, N, and torque about the origin of S, N m, as in `touch.traction.wrench`.
    PREFIXpressure is in Pa, gauge, and PREFIXtouching is 0 or 1. The values are NaN where the touch
    is unknown.
    """

    REMEDY = "call bind with the copied model and data"

    def __init__(
        self,
        membrane: Attachment,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        seed: int,
        carrier_contact: bool = True,
    ):
        if data.model is not model:
            raise InputError("is not the data of this model", source="bind", field="data")
        require_finite(model, "bind", "model")
        self._membrane = membrane
        self._lock = threading.Lock()
        self._model = model
        self._data = data
        sequence = np.random.SeedSequence([seed, *membrane.prefix.encode()])
        self._seed = int(sequence.generate_state(1)[0])
        prefix = membrane.prefix
        self._outputs = [_address(model, prefix + name, size) for name, size in OUTPUTS.items()]
        carrier = int(model.body(prefix + BODY).id)
        _require_own_place(model, carrier)
        apply_collision_rule(model, carrier)
        self.reset()
        reached = carrier_geoms.carrier_geoms(model, data, self.sensor)
        if len(reached) and not carrier_contact:
            carrier_geoms.exclude(model, reached)
            reached = reached[:0]
        found = [
            carrier_geoms.carrier_note(model, self.sensor, reached),
            *contact_notes(model, carrier),
        ]
        self.notes = [note for note in found if note]
        """Findings on the scene that `bind` issues as warnings."""

    # -- outputs -----------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """Prefix of the sensor without trailing separators."""
        return self._membrane.prefix.rstrip("/_-.")

    @property
    def design(self) -> SensorDesign:
        return self._membrane.design

    @property
    def touch(self) -> Touch:
        """Touch estimated from the newest image; `age` is the time since that image.

        Raises InputError if the scene was stepped or reset without this finger.
        """
        self._require_time(slack=1.5 * self._model.opt.timestep)
        return replace(self._touch, age=float(self._data.time) - self._touch.time)

    @property
    def shape(self) -> ContactShape:
        """Contact shape estimated from the newest image. It is computed on access, in 0.1 s or
        more.

        Raises InputError as `touch` does.
        """
        return self._perception.shape(self.touch)

    @property
    def image(self) -> Image:
        """The newest image of the sensor's camera."""
        return self._image

    @property
    def seen(self) -> SensorReading:
        """All results of the newest image as one object, safe to read from other threads."""
        return self._reading

    @property
    def gauge_pressure(self) -> float:
        """Chamber pressure at the last step, Pa above ambient, as a pressure sensor measures it."""
        return self.sensor.gauge_pressure

    @property
    def flags(self) -> Flags:
        """Flags since `reset`: reasons for reduced accuracy, by kind (`sharp_edge`,
        `frame_contact`, `speed`, `uncertain`, ...).

        The times are those of the scene.
        """
        return MappingProxyType(merge_flags((self._stepper.flags, self._uncertain.flags)))

    def ground_truth_wrench(self) -> Array:
        """Return the contact wrench of the simulation, for evaluation only.

        Returns:
            (6,) Force, N, and torque about the origin of S, N m, frame S, from the last step. The
            convention is that of `touch.traction.wrench`.
        """
        return membrane_wrench(self._data, self.sensor)

    # -- stepping ----------------------------------------------------------------------------------

    def reset(self) -> None:
        """Start again as after `bind`: inflated, at rest, histories forgotten. Call it after
        `mj_resetData` and the like."""
        mesh = self._membrane.mesh
        effects = self._membrane.effects
        rest = at_rest(self.design, (mesh.nx, mesh.ny), effects, self._seed)
        self._options = _options(self._model)
        self.sensor: AnySensor = self._membrane.bind(self._model, self._data)
        """The membrane, its gas and its valve."""
        self.sensor.inflate(rest.displacements, rest.gauge_pressure)
        self._camera = SimCamera(self.sensor, self._seed, effects)
        self._valve = SimValve(self.sensor, self._seed)
        self._finger = Finger(self.name, self.design, self._camera, self._valve)
        self._perception = StatefulPipeline(rest.pipeline, rest.state)
        self._stepper = Stepper(self._model, self._data, [self.sensor])
        self._uncertain = UncertainForceMonitor([self.name])
        self._is_stepping = False
        self._time = float(self._data.time)
        self._process_image()
        self._next_image = self._time + self._period

    def belongs_to(self, data: mujoco.MjData) -> bool:
        """Return True if this finger was bound to the given data.

        Args:
            data: MuJoCo data.

        Returns:
            True if it is bound to `data`.
        """
        return data is self._data

    def require_scene(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Check that a scene is the one to which this finger is bound, with the same options.

        Args:
            model: MuJoCo model.
            data: MuJoCo data.

        Raises:
            InputError: The finger is bound to another model or other data, or an option of the
                model was changed after `bind`.
        """
        for field, given, bound in (("data", data, self._data), ("model", model, self._model)):
            if given is not bound:
                raise InputError(
                    f"is bound to another {field}; call bind with this one",
                    source=f"finger {self.name!r}",
                    field=field,
                )
        options = _options(model)
        if options == self._options:
            return
        for name, old, new in zip(_OPTIONS, self._options, options, strict=True):
            if old != new:
                raise InputError(
                    f"was changed from {old:g} to {new:g} after bind: set it back, or call "
                    "reset() of every finger",
                    source=f"finger {self.name!r}",
                    field=f"option.{name}",
                )

    @contextmanager
    def exclusive(self) -> Iterator[None]:
        """Reserve the finger for one thread at a time.

        Yields:
            None.

        Raises:
            InputError: Another thread steps the scene.
        """
        if not self._lock.acquire(blocking=False):
            message = "is stepped by another thread; step a scene in one thread at a time"
            raise InputError(message, source=f"finger {self.name!r}")
        try:
            yield
        finally:
            self._lock.release()

    def before_step(self) -> None:
        """Advance the gas to the current state. Callers that use `mj_step` directly must call this
        right before it.

        Raises InputError when the scene was stepped or reset without this finger, or `after_step`
        was left out.
        """
        self.require_scene(self._model, self._data)
        self._require_time()
        self._require_order(is_stepping=False)
        self._is_stepping = True
        self._stepper.before_step()

    def after_step(self) -> None:
        """Check the state, and process an image if one is due.

        Callers that use `mj_step` directly must call this right after it.

        Raises:
            InputError: `before_step` was left out.
            SimulationError: The state is invalid: it diverged, or an object passed through the
                membrane.
        """
        self._require_order(is_stepping=True)
        self._is_stepping = False
        self._time = float(self._data.time)
        self._stepper.after_step()
        if self._time > self._next_image - self._model.opt.timestep / 2:
            self._process_image()
            periods = max(1, math.ceil((self._time - self._next_image) / self._period))
            self._next_image += self._period * periods
        self._write()

    @property
    def _period(self) -> float:
        return 1.0 / self.design.camera.rate

    def _process_image(self) -> None:
        self._image = self._camera.read()
        reading = self._finger.pressure_reading(self._valve.state())
        self._touch = self._perception.perceive(self._image, self._time, reading)
        self._uncertain.on_touches(self._time, [self._touch])
        reference = self._perception.state.reference
        rest = None if reference is None else reference.surface
        gas = (self.gauge_pressure, self.sensor.temperature)
        self._reading = SensorReading(self._image, self._touch, rest, *gas)
        self._write()

    def _write(self) -> None:
        """Bring the MuJoCo sensors up to date."""
        touch = self._touch
        known = self._touch.status == "ok"
        wrench = touch.traction.wrench if known and touch.traction is not None else math.nan
        values = (wrench, self.gauge_pressure, touch.touching if known else math.nan)
        for address, value in zip(self._outputs, values, strict=True):
            self._data.sensordata[address] = value

    def _require_order(self, *, is_stepping: bool) -> None:
        """Raise InputError if a step has begun or not, other than `is_stepping`."""
        if self._is_stepping != is_stepping:
            raise InputError(
                "needs before_step() directly before each mj_step and after_step() directly after "
                "it, or mjtactile.step; call reset() first",
                source=f"finger {self.name!r}",
            )

    def _require_time(self, slack: float = 0.0) -> None:
        """Raise InputError if this finger is more than `slack`, s, behind the scene."""
        now = float(self._data.time)
        if not now >= self._time:  # also NaN
            raise InputError(
                f"time decreased from {self._time:g} to {now:g} s: call reset() of every "
                "finger after mj_resetData",
                source=f"finger {self.name!r}",
            )
        if now > self._time + slack:
            raise InputError(
                f"is at {self._time:g} s while the scene is at {now:g} s: call "
                "mjtactile.step(model, data, fingers) with all fingers instead of mj_step, "
                "or reset()",
                source=f"finger {self.name!r}",
            )


@validated(nstep=not_below(0))
def step(
    model: mujoco.MjModel, data: mujoco.MjData, fingers: Sequence[SimFinger], nstep: int = 1
) -> None:
    """Advance the scene and its fingers, like `mj_step`.

    Each time step updates the gas, steps the scene, and processes the images that are due.

    Args:
        model: Model of the scene.
        data: Data of the scene.
        fingers: All fingers that are bound in the scene.
        nstep: Number of time steps.

    Raises:
        InputError: The scene was stepped or reset without a finger, a finger is given twice or
            bound to another model or other data, an option was changed after `bind`, or another
            thread steps the scene.
        SimulationError: The state is no longer reliable.
    """
    for finger in fingers:
        finger.require_scene(model, data)
    names = [finger.name for finger in fingers]
    if len(set(names)) < len(names):
        text = f"each finger must be given once, not {', '.join(names)}"
        raise InputError(text, source="step", field="fingers")
    with ExitStack() as stack:
        for finger in fingers:
            stack.enter_context(finger.exclusive())
        for _ in range(nstep):
            for finger in fingers:
                finger.before_step()
            advance(model, data)
            for finger in fingers:
                finger.after_step()


def _options(model: mujoco.MjModel) -> tuple[float, ...]:
    """Return the values of `_OPTIONS`."""
    option = model.opt
    values = [getattr(option, name) for name in _OPTIONS]
    values[-1] &= NEEDED_FLAGS  # others, such as autoreset, may change
    return tuple(values)


def _require_own_place(model: mujoco.MjModel, carrier: int) -> None:
    """Raise InputError if another sensor is attached at the same place as this `carrier`."""
    poses = np.c_[model.body_parentid, model.body_pos, model.body_quat]
    for other in np.flatnonzero((poses == poses[carrier]).all(axis=1)):
        name = model.body(other).name
        sensor = f"{name.removesuffix(BODY)}wrench"
        if other != carrier and mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, sensor) >= 0:
            message = f"{name!r} is at the same place: attach each sensor to its own site"
            raise InputError(message, source="bind", field="model")


def _address(model: mujoco.MjModel, name: str, size: int) -> slice:
    """Return the slice of a sensor's values in `sensordata`. Raises InputError without it."""
    found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name)
    if found < 0:
        raise InputError(
            f"has no sensor {name!r}; compile it from the spec to which the sensor was attached",
            source="bind",
            field="model",
        )
    start = int(model.sensor_adr[found])
    return slice(start, start + size)
