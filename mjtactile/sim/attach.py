"""`attach`: put a vision-based tactile sensor into any MuJoCo scene. The plugin's front door.

    spec = mujoco.MjSpec.from_file("my_robot.xml")
    recommend_options(spec)                                  # integrator, solver, cone, timestep
    left = attach(spec, "dense", site="left_fingertip", prefix="left_")
    right = attach(spec, "dense", site="right_fingertip", prefix="right_")
    model = spec.compile()
    data = mujoco.MjData(model)
    sensors = [left.bind(model, data), right.bind(model, data)]
    while True:
        for sensor in sensors:
            sensor.update()                                  # gas: before every mj_step
        mujoco.mj_step(model, data)
        centres, normals = sensors[0].marker_poses()         # m, in the sensor's frame

The site's frame becomes the sensor's frame S: origin in the middle of the flat membrane, z outward.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco

from mjtactile.design import SensorDesign, load_sensor
from mjtactile.errors import InputError
from mjtactile.sim import features, limits
from mjtactile.sim.membrane import BODY, FLEX, add_membrane
from mjtactile.sim.mesh import MembraneMesh, make_mesh
from mjtactile.sim.sensor import TactileSensor
from mjtactile.sim.switches import PHYSICS, set_physics

TIMESTEP_RANGE = (1e-4, 8e-3)
DEFAULT_MESH = (13, 11)
_SOLVER_NAMES = {0: "PGS", 1: "CG", 2: "Newton"}
_INTEGRATOR_NAMES = {0: "Euler", 1: "RK4", 2: "implicit", 3: "implicitfast", 4: "discrete"}


@dataclass(frozen=True, eq=False)
class Attachment:
    """A sensor that `attach` put into a spec; `bind` it to each model compiled from that spec."""

    design: SensorDesign
    mesh: MembraneMesh
    prefix: str
    contact: str = "auto"
    effects: frozenset[str] = PHYSICS

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> TactileSensor:
        """Return the sensor's runtime, and finish the model: pre-stretch and contact stiffness.

        Call it again after `spec.recompile`. Raises InputError when the model's options cannot carry the sensor or
        the model was not compiled from the spec.
        """
        check_options(model.opt, source="bind")
        return TactileSensor(model, data, self.design, self.mesh, self.prefix, self.contact, self.effects)


def attach(spec: mujoco.MjSpec, sensor: SensorDesign | str | Path, *, site: mujoco.MjsSite | str, prefix: str = "tactile_",
           mesh: tuple[int, int] = DEFAULT_MESH, mass: float = 0.05, contact: str = "auto",
           effects: frozenset[str] = PHYSICS) -> Attachment:
    """Attach `sensor` (a design, a shipped name or a TOML file) to the parent scene `spec` at `site`.

    `prefix` keeps several sensors apart, `mesh` is the number of vertices along x and y, `mass` kg that of frame,
    glass and camera; `contact` says what of the membrane touches: its "vertices", its triangles ("elements"), "both", or
    "auto" by the scene's smallest feature; `effects` are names of effects.py. Raises InputError for an unknown site, a
    prefix already used, a membrane that the method cannot carry, or options of `spec` that cannot (MuJoCo never takes
    them from an attached child).
    """
    design = load_sensor(sensor)
    check_options(spec.option, source="attach")
    limits.check_design(design, mesh)
    if contact not in ("auto", *features.CONTACT_MODELS):
        raise InputError(f"{contact!r} is not a contact model", source="attach", field="contact",
                         choices=["auto", *features.CONTACT_MODELS])
    target = spec.site(site) if isinstance(site, str) else site
    if target is None:
        raise InputError(f"no site {site!r} in the scene", source="attach", field="site",
                         choices=[s.name for s in spec.sites if s.name])
    if not prefix:
        raise InputError("must not be empty: MuJoCo cannot save such a model", source="attach", field="prefix")
    if spec.body(prefix + BODY) is not None or any(flex.name == prefix + FLEX for flex in spec.flexes):
        raise InputError(f"{prefix!r} is taken: the scene has a body {prefix + BODY!r}", source="attach",
                         field="prefix")
    grid = make_mesh(design.frame.length, design.frame.width, *mesh, shape=design.frame.shape)
    child = mujoco.MjSpec()
    body = child.worldbody.add_body(name=BODY)
    _add_housing(body, design, mass)
    add_membrane(child, body, design, grid)
    set_physics(child, grid, effects)
    spec.attach(child, site=target, prefix=prefix)
    return Attachment(design, grid, prefix, contact, effects)


def recommend_options(spec: mujoco.MjSpec, timestep: float = 4e-3) -> None:
    """Set the options of `spec` that membranes need or like best; leaves gravity and all the rest alone."""
    option = spec.option
    option.timestep = timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    option.solver = mujoco.mjtSolver.mjSOL_CG
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC  # fewer rows and faster to converge than the pyramid
    option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    option.tolerance, option.iterations = 1e-7, 300  # noise of the held force: 1e-6 leaves 6 mN, 1e-7 1 mN
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a diverged run must not rewind and go on silently


def check_options(option: Any, *, source: str) -> None:
    """Raise InputError naming option, value and needed value when `option` cannot carry a membrane with gas.

    `option` is a spec's or a compiled model's.
    """
    def refuse(name: str, value: object, need: str, why: str) -> None:
        raise InputError(f"is {value}, must be {need}: {why}", source=source, field=f"option.{name}")

    if option.integrator != mujoco.mjtIntegrator.mjINT_DISCRETE:
        refuse("integrator", _INTEGRATOR_NAMES.get(int(option.integrator), option.integrator), "discrete",
               "only it is implicit in the stiffness of membrane and gas")
    if option.solver != mujoco.mjtSolver.mjSOL_CG:
        refuse("solver", _SOLVER_NAMES.get(int(option.solver), option.solver), "CG",
               "the gas couples all vertices, which makes Newton's Hessian dense and PGS explicit")
    low, high = TIMESTEP_RANGE
    if not low <= option.timestep <= high:
        refuse("timestep", f"{option.timestep:g} s", f"{low:g} to {high:g} s", "contact forces are wrong beyond")
    if option.jacobian == mujoco.mjtJacobian.mjJAC_DENSE:
        refuse("jacobian", "dense", "sparse or auto", "a membrane has hundreds of degrees of freedom")
    if option.noslip_iterations:
        refuse("noslip_iterations", option.noslip_iterations, "0", "it treats membrane stiffness explicitly")
    if option.disableflags & (mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT):
        refuse("flag", "contact or constraint disabled", "both enabled", "the membrane would touch nothing")
    for flag, name in ((mujoco.mjtDisableBit.mjDSBL_SPRING, "spring"), (mujoco.mjtDisableBit.mjDSBL_DAMPER, "damper")):
        if option.disableflags & flag:
            refuse("flag", f"{name} disabled", f"{name} enabled", "membrane and gas are passive forces")


def _add_housing(body: mujoco.MjsBody, design: SensorDesign, mass: float) -> None:
    """Frame walls around the chamber and a block for glass and camera behind it; nothing in front of z = 0.

    A circular frame gets the walls of the square around it: what touches between circle and square touches nothing.
    """
    frame, depth = design.frame, design.chamber.depth
    rim = max(frame.rim, 1e-3)
    half_x, half_y = frame.length / 2, frame.width / 2
    back = max(design.camera.distance - depth, 1e-3)
    boxes = [
        ((0, sign * (half_y + rim / 2), -depth / 2), (half_x + rim, rim / 2, depth / 2)) for sign in (-1, 1)
    ] + [
        ((sign * (half_x + rim / 2), 0, -depth / 2), (rim / 2, half_y, depth / 2)) for sign in (-1, 1)
    ] + [((0, 0, -depth - back / 2), (half_x + rim, half_y + rim, back / 2))]
    for number, (pos, size) in enumerate(boxes):
        body.add_geom(name=f"housing{number}", type=mujoco.mjtGeom.mjGEOM_BOX, pos=pos, size=size,
                      mass=mass / len(boxes), contype=0, conaffinity=1, rgba=[0.25, 0.27, 0.3, 1.0])
