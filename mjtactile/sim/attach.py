"""`attach_membrane`: add a sensor's membrane, gas and housing to any MuJoCo scene.

`mjtactile.attach` adds the sensing pipeline.

    spec = mujoco.MjSpec.from_file("my_robot.xml")
    configure_options(spec)                                  # integrator, solver, cone, timestep
    left = attach_membrane(spec, "dense", site="left_fingertip", prefix="left_")
    right = attach_membrane(spec, "dense", site="right_fingertip", prefix="right_")
    model = spec.compile()
    data = mujoco.MjData(model)
    sensors = [left.bind(model, data), right.bind(model, data)]
    while True:
        for sensor in sensors:
            sensor.update()                                  # gas: before every mj_step
        mujoco.mj_step(model, data)  # or mjtactile.sim.fast_step.advance, in half the time
        centres, normals = sensors[0].marker_poses()         # m, in the sensor's frame

The site's frame becomes the sensor's frame S: origin in the center of the flat membrane, z
outward.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.effect_names import Effect
from mjtactile.core.errors import InputError
from mjtactile.core.outline import Outline
from mjtactile.core.signature_checks import validated, within
from mjtactile.sim.sensor import feature_size, validity_checks
from mjtactile.sim.sensor.effect_switches import PHYSICS, effects_named, set_law, set_physics
from mjtactile.sim.sensor.membrane import ANYTHING, BODY, FLEX, add_membrane
from mjtactile.sim.sensor.mesh import MembraneMesh, make_mesh
from mjtactile.sim.sensor.mesh_sensor import TactileSensor
from mjtactile.sim.sensor.own_links import exclude_own_links
from mjtactile.sim.sensor.quasistatic_geoms import QS_GRID, add_feeler
from mjtactile.sim.sensor.quasistatic_sensor import QuasistaticSensor

TIMESTEP_RANGE = (1e-4, 8e-3)
DEFAULT_MESH = (13, 11)
_OPTION_NAMES = {
    "integrator": {0: "Euler", 1: "RK4", 2: "implicit", 3: "implicitfast", 4: "discrete"},
    "solver": {0: "PGS", 1: "CG", 2: "Newton"},
    "cone": {0: "pyramidal", 1: "elliptic"},
    "jacobian": {0: "dense", 1: "sparse", 2: "auto"},
}
_REQUIRED = {
    "integrator": (
        mujoco.mjtIntegrator.mjINT_DISCRETE,
        "only this one is implicit in the stiffness of membrane and gas",
    ),
    "solver": (
        mujoco.mjtSolver.mjSOL_CG,
        "the gas couples all vertices, which makes Newton's Hessian dense and PGS explicit",
    ),
    "cone": (mujoco.mjtCone.mjCONE_ELLIPTIC, "static friction needs its friction rows"),
}
_RECOMMENDED = {
    **_REQUIRED,
    "jacobian": (mujoco.mjtJacobian.mjJAC_SPARSE, "a membrane has hundreds of degrees of freedom"),
    "tolerance": (1e-7, "1e-5 leaves 2 mN of noise in a constant force, 1e-4 leaves 6 mN"),
    "iterations": (300, "the first touch may need as many"),
    "noslip_iterations": (0, "they treat membrane stiffness explicitly"),
}
_NEEDED = {
    mujoco.mjtDisableBit.mjDSBL_CONTACT: "the membrane would touch nothing",
    mujoco.mjtDisableBit.mjDSBL_CONSTRAINT: "the membrane would touch nothing",
    mujoco.mjtDisableBit.mjDSBL_SPRING: "membrane and gas are passive forces",
    mujoco.mjtDisableBit.mjDSBL_DAMPER: "membrane and gas are passive forces",
}
NEEDED_FLAGS = sum(int(flag) for flag in _NEEDED)
"""Bits of `disableflags` that must be 0."""
_WALLS = 24  # boxes around an outline: 0.1 mm deviation for 30 mm
_MAX_GRAVITY = 1000.0  # m/s^2: a centrifuge of 100 g
_MIN_MEMORY = 1 << 24  # bytes


@dataclass(frozen=True, eq=False)
class Attachment:
    """A sensor that `attach_membrane` put into a spec; `bind` it to each model compiled from it."""

    design: SensorDesign
    mesh: MembraneMesh
    prefix: str
    contact: str = "auto"
    effects: frozenset[Effect] = PHYSICS

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> TactileSensor | QuasistaticSensor:
        """Return the sensor's runtime, and finish the model: pre-stretch and contact stiffness.

        Raises InputError when the model's options cannot carry the sensor, or for another spec.
        """
        check_options(model.opt, source="bind")
        if Effect.MESH not in self.effects:
            return QuasistaticSensor(model, data, self.design, self.mesh, self.prefix, self.effects)
        return TactileSensor(
            model, data, self.design, self.mesh, self.prefix, self.contact, self.effects
        )


def attach_membrane(
    spec: mujoco.MjSpec,
    sensor: SensorDesign | str | Path,
    *,
    site: mujoco.MjsSite | str,
    prefix: str = "tactile_",
    mesh: tuple[int, int] | None = None,
    mass: float = 0.05,
    contact: str = "auto",
    effects: Collection[str] | str = PHYSICS,
) -> Attachment:
    """Attach `sensor` (a design, a shipped name or a TOML file) to `spec` at `site`.

    `prefix` distinguishes several sensors. `mesh` is the number of vertices along x and y. `mass`,
    kg, is that of frame, glass and camera. `contact` selects the contact geometry of the membrane:
    its "vertices", its triangles ("elements"), "both", or "auto" by the scene's smallest feature.
    `effects` are those of `Effect`, their names, or changes of the default such as "-mesh". Raises
    InputError for an unknown site or effect, a prefix already used, or a membrane or options of
    `spec` that the method cannot carry.
    """
    on = effects_named(effects)
    design = set_law(load_sensor(sensor), on)
    if mesh is None:
        mesh = default_mesh(design) if Effect.MESH in on else QS_GRID
    check_options(spec.option, source="attach")
    validity_checks.check_design(design, mesh)
    _check_contact(contact)
    target = _site(spec, site)
    _check_prefix(spec, prefix)
    grid = make_mesh(design.frame.length, design.frame.width, *mesh, outline=design.frame.outline)
    child = mujoco.MjSpec()
    body = child.worldbody.add_body(name=BODY)
    # same gravity compensation as the parent: it then includes the sensor's weight
    body.gravcomp = target.parent.gravcomp
    _add_housing(body, design, mass)
    if Effect.MESH in on:
        add_membrane(child, body, design, grid)
        set_physics(child, grid, on)
    elif design.relaxation is not None:
        raise InputError(
            "the rubber of a quasi-static membrane does not relax: leave out relaxation as "
            "well as the mesh",
            source=design.name,
            field="effects",
        )
    else:
        add_feeler(body, design)
    try:
        spec.attach(child, site=target, prefix=prefix)
    except ValueError as error:
        raise InputError(" ".join(str(error).split()), source="attach", field="site") from error
    if Effect.MESH in on:
        vertices = [f"{prefix}v{vertex}" for vertex in grid.interior]
        exclude_own_links(spec, target.parent, vertices)
    return Attachment(design, grid, prefix, contact, on)


def _check_contact(contact: str) -> None:
    if contact not in ("auto", *feature_size.CONTACT_MODELS):
        raise InputError(
            f"{contact!r} is not a contact model",
            source="attach",
            field="contact",
            choices=["auto", *feature_size.CONTACT_MODELS],
        )


def _check_prefix(spec: mujoco.MjSpec, prefix: str) -> None:
    if not prefix:
        raise InputError(
            "must not be empty: MuJoCo cannot save such a model", source="attach", field="prefix"
        )
    is_taken = any(flex.name == prefix + FLEX for flex in spec.flexes)
    if is_taken or spec.body(prefix + BODY) is not None:
        raise InputError(
            f"{prefix!r} is already in use: the scene has a body {prefix + BODY!r}",
            source="attach",
            field="prefix",
        )


def default_mesh(design: SensorDesign) -> tuple[int, int]:
    """Return the default number of vertices along x and y.

    It is `DEFAULT_MESH` for a rectangle. An outline has at least as many vertices, nearly square
    cells, and one vertex in the center.
    """
    frame = design.frame
    if frame.outline is None:
        return DEFAULT_MESH
    along = math.sqrt(math.prod(DEFAULT_MESH) * frame.length / frame.width)
    across = math.prod(DEFAULT_MESH) / along
    return 2 * math.ceil((along - 1) / 2) + 1, 2 * math.ceil((across - 1) / 2) + 1


@validated(timestep=within(*TIMESTEP_RANGE))
def configure_options(spec: mujoco.MjSpec, timestep: float = 4e-3) -> tuple[str, ...]:
    """Set the scene options required or recommended for membranes. Gravity and all others stay
    unchanged.

    Args:
        spec: The scene.
        timestep: Time step, s.

    Returns:
        One line for each changed option: the old value, the new value and the reason.
    """
    option = spec.option
    changes = []
    for name, (value, why) in {
        **_RECOMMENDED,
        "timestep": (timestep, "forces are accurate to 1 mN from 1 to 7 ms"),
    }.items():
        before = getattr(option, name)
        if before != value:
            setattr(option, name, value)
            changes.append(
                f"option.{name}: {_readable(name, before)} -> {_readable(name, value)} ({why})"
            )
    for flag, why in _NEEDED.items():
        if option.disableflags & flag:
            option.disableflags &= ~int(flag)
            changes.append(
                f"flag {flag.name.removeprefix('mjDSBL_').lower()}: disable -> enable ({why})"
            )
    if not option.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET:
        option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        changes.append(
            "flag autoreset: enable -> disable (a diverged run must not restart silently)"
        )
    if option.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE:
        option.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)
        changes.append(
            "flag override: enable -> disable (the membrane needs its own contact stiffness)"
        )
    if 0 <= spec.memory < _MIN_MEMORY:
        changes.append(
            f"size.memory: {spec.memory} bytes -> as needed (a touching membrane has hundreds "
            "of contacts)"
        )
        spec.memory = -1
    return tuple(changes)


def _readable(name: str, value: Any) -> str:
    """Format an option's value as in the MJCF."""
    if name in _OPTION_NAMES:
        return _OPTION_NAMES[name].get(int(value), str(value))
    return f"{value:g} s" if name == "timestep" else f"{value:g}"


def check_options(option: Any, *, source: str) -> None:
    """Raise InputError when the `option` of a spec or model cannot carry a membrane with gas."""

    def refuse(name: str, value: object, need: str, why: str) -> None:
        raise InputError(
            f"is {value}, must be {need}: {why}", source=source, field=f"option.{name}"
        )

    for name, (needed, why) in _REQUIRED.items():
        if getattr(option, name) != needed:
            refuse(
                name, _readable(name, getattr(option, name)), _OPTION_NAMES[name][int(needed)], why
            )
    low, high = TIMESTEP_RANGE
    if not low <= option.timestep <= high:
        refuse(
            "timestep",
            f"{option.timestep:g} s",
            f"{low:g} to {high:g} s",
            "contact forces are wrong outside this range",
        )
    _check_gravity(option, source)
    if option.jacobian == mujoco.mjtJacobian.mjJAC_DENSE:
        refuse(
            "jacobian", "dense", "sparse or auto", "a membrane has hundreds of degrees of freedom"
        )
    if option.noslip_iterations:
        refuse(
            "noslip_iterations",
            option.noslip_iterations,
            "0",
            "it treats membrane stiffness explicitly",
        )
    for flag, why in _NEEDED.items():
        if option.disableflags & flag:
            refuse("flag", f"{flag.name.removeprefix('mjDSBL_').lower()} disabled", "enabled", why)
    if option.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE:
        refuse(
            "flag", "override enabled", "disabled", "the membrane needs its own contact stiffness"
        )


def _check_gravity(option: Any, source: str) -> None:
    """Raise InputError for the gravity of a scene in mm."""
    gravity = float(np.linalg.norm(option.gravity))
    if gravity > _MAX_GRAVITY:
        text = f"is {gravity:g} m/s2, must be at most {_MAX_GRAVITY:g}: lengths are in m, not in mm"
        raise InputError(text, source=source, field="option.gravity")


def _site(spec: mujoco.MjSpec, site: mujoco.MjsSite | str) -> mujoco.MjsSite:
    """Return the site to attach to. Raises InputError if it is missing or on a mocap body."""
    found = spec.site(site) if isinstance(site, str) else site
    if found is None:
        raise InputError(
            f"the scene has no site {site!r}",
            source="attach",
            field="site",
            choices=[s.name for s in spec.sites if s.name],
        )
    if found.parent is None or (found.name and spec.site(found.name) is None):
        raise InputError("the site is of another scene", source="attach", field="site")
    carrier = _mocap_carrier(found.parent)
    if carrier is not None:
        raise InputError(
            f"{found.name!r} is on the mocap body {carrier!r}, which cannot carry a membrane: "
            "put it on a body that a weld connects to this one",
            source="attach",
            field="site",
        )
    return found


def _mocap_carrier(body: mujoco.MjsBody | None) -> str | None:
    """Return the name of the mocap body that `body` is, or is fixed to; None for others."""
    while body is not None and not list(body.joints):
        if body.mocap:
            return body.name
        body = body.parent
    return None


def _add_housing(body: mujoco.MjsBody, design: SensorDesign, mass: float) -> None:
    """Add frame walls around the chamber, behind z = 0, and a block for glass and camera."""
    frame = design.frame
    depth = design.chamber.depth
    rim = max(frame.rim, 1e-3)
    half_x = frame.length / 2
    half_y = frame.width / 2
    back = max(design.camera.distance - depth, 1e-3)
    walls = (
        [(0.0, sign * (half_y + rim / 2), half_x + rim, rim / 2, 0.0) for sign in (-1, 1)]
        + [(sign * (half_x + rim / 2), 0.0, rim / 2, half_y, 0.0) for sign in (-1, 1)]
        if frame.outline is None
        else _walls_around(frame.outline, rim)
    )
    boxes = [((x, y, -depth / 2), (a, b, depth / 2), angle) for x, y, a, b, angle in walls]
    boxes.append(((0, 0, -depth - back / 2), (half_x + rim, half_y + rim, back / 2), 0.0))
    for index, (pos, size, angle) in enumerate(boxes):
        body.add_geom(
            name=f"housing{index}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=pos,
            quat=[math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)],
            size=size,
            mass=mass / len(boxes),
            contype=0,
            conaffinity=ANYTHING,
            rgba=[0.25, 0.27, 0.3, 1.0],
        )


def _walls_around(outline: Outline, rim: float) -> list[tuple[float, float, float, float, float]]:
    """Return x, y, half length, half width, m, and angle of walls that touch an outline."""
    at = outline.points(2 * _WALLS)
    ends = at[::2]
    touching = at[1::2]
    along = np.roll(ends, -1, axis=0) - ends
    lengths = np.linalg.norm(along, axis=1)
    along /= lengths[:, None]
    outward = np.column_stack([along[:, 1], -along[:, 0]])
    # to where the outline is farthest out, so that no wall reaches into the opening
    farthest = np.maximum((touching * outward).sum(1), (ends * outward).sum(1))
    midpoint = (ends + np.roll(ends, -1, axis=0)) / 2
    out = farthest - (midpoint * outward).sum(1) + rim / 2
    centers = midpoint + outward * out[:, None]
    # neighbours overlap at their outer corners' gap
    half = lengths / 2 + rim * np.pi / _WALLS
    angles = np.arctan2(along[:, 1], along[:, 0])
    half_rim = np.full(_WALLS, rim / 2)
    return [tuple(wall) for wall in np.column_stack([centers, half, half_rim, angles]).tolist()]
