"""Objects to grasp: read a user's MJCF, check it, and merge it into a scene.

The format is in docs, "Your own object". It has one top-level MuJoCo body named `object` with a
free joint. A volumetric flex may replace the joint. A text `material` is required.

The object counts as crushed above a normal force per finger. This force is the `<custom>` numeric
`break_force_N`. A flex may also have `break_stress_kPa` or `break_energy_kJ_m3`.

The table's top is z = 0, and the fingers close along x. They grasp at the height of the MuJoCo
body's origin. A numeric `grasp_height_m` specifies another height. A numeric `rotation_deg` limits
the random rotation about z (a block between flat fingers). All other MuJoCo bodies of the file (a
cup, a stand) are added too.
"""

from __future__ import annotations

import difflib
import logging
import math
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core import resources
from mjtactile.core.errors import InputError
from mjtactile.core.renamed import KEYS, hint
from mjtactile.core.types import Array
from mjtactile.rig.domain_randomization import UNCHANGED, ObjectChange
from mjtactile.sim.finite_model import require_finite
from mjtactile.sim.scenes.liquid import Liquid, add_liquid, liquid_in
from mjtactile.sim.scenes.mjcf import change, changed_options, read_mjcf, take_options
from mjtactile.sim.scenes.random_objects import object_text

_logger = logging.getLogger(__name__)

MATERIALS = ("solid", "soft", "amorphous")
NUMERICS = (
    "break_force_N",
    "break_stress_kPa",
    "break_energy_kJ_m3",
    "grasp_height_m",
    "rotation_deg",
)
PREFIX = "object/"
"""Names of the object's file carry this prefix in the scene."""
PLACE_PREFIX = "place/"
"""Names of the supports at the end of a path carry this prefix."""
SOFT_ITERATIONS = 2000
"""Maximum solver iterations of a membrane with finite elements; 100 is usual."""


@dataclass(frozen=True)
class FlexMaterial:
    """Material of a volumetric flex, `young` Pa and `poisson`, and its strength.

    The limits apply to the twentieth of the volume under the highest load: `break_stress` Pa (von
    Mises) and `break_energy` J/m^3 of strain.
    """

    young: float
    poisson: float
    break_stress: float = math.inf
    break_energy: float = math.inf


@dataclass(frozen=True)
class ObjectModel:
    """Checked object.

    `break_force` is N per finger, `grasp_height` m above the table, `turn` rad the maximum random
    rotation about z. `changes` are those of the simulated object relative to its file (`changed`).
    `text` is the MJCF of an object without a file. `width` along x, the closing direction, is in m.
    `liquid` is in addition to the mass of its file.
    """

    name: str
    path: Path
    break_force: float
    material: str
    grasp_height: float
    mass: float
    turn: float = math.pi
    flex_material: FlexMaterial | None = None
    changes: ObjectChange = UNCHANGED
    text: str = ""
    width: float | None = None
    liquid: Liquid | None = None

    def changed(self, changes: ObjectChange) -> ObjectModel:
        """Return this object with `changes` to its size, mass, stiffness and strength."""
        strength = 1 + changes.breaking
        flex_material = self.flex_material
        if flex_material is not None:
            flex_material = FlexMaterial(
                (1 + changes.stiffness) * flex_material.young,
                flex_material.poisson,
                strength * flex_material.break_stress,
                strength * flex_material.break_energy,
            )
        return replace(
            self,
            break_force=strength * self.break_force,
            flex_material=flex_material,
            changes=changes,
            mass=(1 + changes.size) ** 3 * (1 + changes.mass) * self.mass,
            width=None if self.width is None else (1 + changes.size) * self.width,
        )


def load_object(name_or_path: str | Path) -> ObjectModel:
    """Read and check an object by shipped name or from an MJCF file; "random:7" is that of seed 7.

    Raises InputError naming file, field and valid choices for broken MJCF, missing elements or
    numerics, an unknown material, or an object without contact geometry.
    """
    text = object_text(str(name_or_path)) or ""
    path = Path(name_or_path) if text else resources.find(name_or_path, "models/objects", ".xml")
    spec = read_mjcf(path, text)
    _check_body(spec, path)
    _check_numerics(spec, path)
    if options := changed_options(spec):
        names = ", ".join(options)
        _logger.warning("%s: <option> %s has no effect: the scene's do", path, names)
    flex_material = _flex_material(spec, path)
    has_strain_limit = (
        flex_material is not None
        and min(flex_material.break_stress, flex_material.break_energy) < math.inf
    )
    break_force = _numeric(
        spec, path, "break_force_N", default=math.inf if has_strain_limit else None
    )
    body = spec.body("object")
    height = _numeric(spec, path, "grasp_height_m", default=float(body.pos[2]))
    angle = min(math.radians(_numeric(spec, path, "rotation_deg", default=180.0)), math.pi)
    mass, width = _check_compiled(spec, path)
    return ObjectModel(
        path.stem,
        path,
        break_force,
        _material(spec, path),
        height,
        mass,
        angle,
        flex_material,
        text=text,
        width=width,
    )


def add_object(
    scene: mujoco.MjSpec,
    model: ObjectModel,
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    height: float = 0.0,
) -> None:
    """Merge the object's file into `scene` under the name prefix "object/".

    `pose` is x, y in m and yaw in rad of the file's world on the table, whose top is at `height` m.
    Raises InputError when the pose is not finite.
    """
    x, y, yaw = pose
    if not all(math.isfinite(value) for value in pose):
        raise InputError(f"{pose!r} is not three finite numbers", source="add_object", field="pose")
    frame = scene.worldbody.add_frame(
        pos=[x, y, height], quat=[math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]
    )
    spec = read_spec(model)
    change(spec, model.changes)
    if model.liquid is not None:
        fill(spec, model.liquid)
    take_options(spec, scene)
    scene.attach(spec, frame=frame, prefix=PREFIX)
    if model.flex_material is not None:
        scene.option.iterations = max(scene.option.iterations, SOFT_ITERATIONS)


def add_supports(
    scene: mujoco.MjSpec, model: ObjectModel, pose: tuple[float, float, float], height: float = 0.0
) -> None:
    """Add the static MuJoCo bodies of the object's file (a cup, a stand) at another place.

    `pose` and `height` are those of `add_object`; names have the prefix "place/".
    """
    x, y, yaw = pose
    frame = scene.worldbody.add_frame(
        pos=[x, y, height], quat=[math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]
    )
    spec = read_spec(model)
    change(spec, model.changes)
    for body in spec.worldbody.bodies:
        if body.name != "object" and not body.joints:
            frame.attach_body(body, PLACE_PREFIX, "")


def with_liquid(model: ObjectModel, level: float) -> ObjectModel:
    """Return the object with water up to `level` of its height. Raises InputError for a soft
    object."""
    if model.flex_material is not None:
        text = "is soft; the task fills it with a liquid, which requires a rigid object"
        raise InputError(text, source=model.path, field="object")
    spec = read_spec(model)
    change(spec, model.changes)
    compiled, data = _compiled(spec)
    low, high = _corners(compiled, data, moving_bodies(compiled))
    liquid = liquid_in(low, high, level)
    return replace(model, liquid=liquid, mass=model.mass + liquid.mass)


def fill(spec: mujoco.MjSpec, liquid: Liquid) -> None:
    """Add a liquid to the object of a file."""
    model, data = _compiled(spec)
    body = model.body("object").id
    add_liquid(spec.body("object"), data.xpos[body], data.xmat[body].reshape(3, 3), liquid)


def read_spec(model: ObjectModel) -> mujoco.MjSpec:
    """Return the specification of its file, before any changes."""
    return read_mjcf(model.path, model.text)


def _check_body(spec: mujoco.MjSpec, path: Path) -> None:
    body = spec.body("object")
    if body is None:
        raise InputError(
            "missing body named 'object'",
            source=path,
            field="worldbody",
            choices=[b.name for b in spec.worldbody.bodies if b.name] or None,
        )
    if not any(child.name == "object" for child in spec.worldbody.bodies):
        raise InputError(
            "body 'object' must be a direct child of the world", source=path, field="object"
        )
    if not _solids(spec) and not any(
        joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in body.joints
    ):
        raise InputError(
            "body 'object' has no free joint",
            source=path,
            field="object",
            choices=["<freejoint/>", '<flexcomp dim="3"/>'],
        )


def _solids(spec: mujoco.MjSpec) -> list[mujoco.MjsFlex]:
    return [flex for flex in spec.flexes if flex.dim == 3]


def _flex_material(spec: mujoco.MjSpec, path: Path) -> FlexMaterial | None:
    """Return the material of the object's volumetric flex; None for a rigid or lumped object."""
    solids = _solids(spec)
    if not solids:
        return None
    if len(solids) > 1:
        raise InputError(
            "has more than one volumetric flex; an object is one body",
            source=path,
            field="flexcomp",
            choices=[flex.name for flex in solids],
        )
    if not solids[0].young > 0:
        raise InputError(f"{solids[0].young:g} is not a modulus > 0 Pa", source=path, field="young")
    return FlexMaterial(
        float(solids[0].young),
        float(solids[0].poisson),
        1e3 * _numeric(spec, path, "break_stress_kPa", default=math.inf),
        1e3 * _numeric(spec, path, "break_energy_kJ_m3", default=math.inf),
    )


def _check_numerics(spec: mujoco.MjSpec, path: Path) -> None:
    """Refuse old and misspelled names of numerics; other names are allowed."""
    for name in (numeric.name for numeric in spec.numerics):
        if name in NUMERICS:
            continue
        stem = [known for known in NUMERICS if known.rsplit("_", 1)[0] == name.rsplit("_", 1)[0]]
        near = stem or difflib.get_close_matches(name, NUMERICS, 1, cutoff=0.8)
        if KEYS.get(name) in NUMERICS:
            raise InputError(f"unknown numeric{hint(name)}", source=path, field=name)
        if near:
            text = f"unknown numeric, did you mean {near[0]!r}?"
            raise InputError(text, source=path, field=name, choices=NUMERICS)


def _numeric(spec: mujoco.MjSpec, path: Path, name: str, default: float | None = None) -> float:
    found = [numeric for numeric in spec.numerics if numeric.name == name]
    if not found:
        if default is None:
            raise InputError("missing <custom><numeric>, a number > 0", source=path, field=name)
        return default
    value = float(found[0].data[0]) if len(found[0].data) else math.nan
    if not math.isfinite(value) or value <= 0:
        raise InputError(f"{value:g} is not a finite number > 0", source=path, field=name)
    return value


def _material(spec: mujoco.MjSpec, path: Path) -> str:
    found = [text.data for text in spec.texts if text.name == "material"]
    if not found:
        raise InputError("missing <custom><text>", source=path, field="material", choices=MATERIALS)
    if found[0] not in MATERIALS:
        raise InputError(
            f"{found[0]!r} is not a material", source=path, field="material", choices=MATERIALS
        )
    return found[0]


def _check_compiled(spec: mujoco.MjSpec, path: Path) -> tuple[float, float]:
    """Compile the object alone; return its mass, kg, and its width along x, m."""
    try:
        model, data = _compiled(spec)
    except (ValueError, RuntimeError) as error:
        raise InputError(f"does not compile: {_one_line(error)}", source=path) from error
    require_finite(model, path)
    moving = moving_bodies(model)
    touchable = (model.geom_contype[np.isin(model.geom_bodyid, moving)] & 1).any()
    if not touchable and not (model.flex_contype & 1).any():
        raise InputError(
            "has no geom or flex with contype 1: nothing can touch it", source=path, field="object"
        )
    return float(model.body_mass[moving].sum()), _width(model, data, moving)


def _compiled(spec: mujoco.MjSpec) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return an object's model alone, and its initial state."""
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    spec.option.solver = mujoco.mjtSolver.mjSOL_CG
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def _width(model: mujoco.MjModel, data: mujoco.MjData, bodies: NDArray[np.int64]) -> float:
    """Return the extent along x of the contact geometry of these MuJoCo bodies, m."""
    low, high = _corners(model, data, bodies)
    return float(high[0] - low[0])


def _corners(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Return the lower and upper corner (3,), m, of the contact geometry of these MuJoCo bodies."""
    geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies) & ((model.geom_contype & 1) > 0))
    axes = data.geom_xmat[geoms].reshape(-1, 3, 3)
    center = data.geom_xpos[geoms] + (axes * model.geom_aabb[geoms, None, :3]).sum(axis=2)
    half = (np.abs(axes) * model.geom_aabb[geoms, None, 3:]).sum(axis=2)
    points = np.concatenate([center - half, center + half, data.flexvert_xpos])
    return points.min(axis=0), points.max(axis=0)


def moving_bodies(model: mujoco.MjModel, prefix: str = "") -> NDArray[np.int64]:
    """Return the ids of the movable MuJoCo bodies with name `prefix`, the object's."""
    return np.array(
        [
            i
            for i in range(1, model.nbody)
            if model.body_weldid[i] and model.body(i).name.startswith(prefix)
        ],
        dtype=np.int64,
    )


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
