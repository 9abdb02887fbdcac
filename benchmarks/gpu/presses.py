"""Agreement of membranes in MuJoCo Warp with the CPU's quasi-static membrane: random presses.

Each world has its own object, size, rotation and position. Objects approach in small steps, as in a
simulation, and stay for some steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

import mjtactile
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.quasistatic import QuasistaticMembrane
from mjtactile.quasistatic.obstacles import Obstacle
from mjtactile.sim.sensor.quasistatic_geoms import sticking_of

KINDS = ("ball", "box", "capsule", "cylinder", "ellipsoid", "mesh")
_TORSION_MIN = 1e-9  # N m/rad; a contact of a single node has no torsional stiffness
LIMITS = {"force": 0.02, "pressure": 0.01, "shear": 0.05, "torsion": 0.05}
_SEED = 4700
_MARGIN = 6e-3  # minimum distance of an object's center from the frame, m
_STEP = 5e-5  # step of an approach, m
_HOLD = 10  # steps of the hold
_TILT = 10.0  # maximum, degrees
_AWAY = 10.0  # height of objects of other worlds, m
_SCENE = """
<mujoco>
  <asset>{assets}</asset>
  <worldbody>
    <site name="tip"/>
    {bodies}
  </worldbody>
</mujoco>
"""


@dataclass(frozen=True)
class _Place:
    """Pose of an object at first contact."""

    p: Array
    R: Array

    def raised(self, by: float) -> _Place:
        return _Place(self.p + [0.0, 0.0, by], self.R)


def press_objects(kind: str, count: int, device: str, sensor: str = "dense") -> dict[str, Any]:
    """Press objects of one kind by 0.3 to 2.5 mm.

    Args:
        kind: One of KINDS.
        count: Number of worlds.
        device: Device of Warp.
        sensor: Sensor's name or file.

    Returns:
        "kind", "presses" compared, "refused" by the CPU's solver, "unsettled" on the device, and
        "rms" and "max" errors by quantity.
    """
    import mujoco_warp as mjw
    import warp as wp

    import mjtactile.warp

    rng = np.random.default_rng([_SEED, KINDS.index(kind)])
    objects = [_sample(kind, rng) for _ in range(count)]
    model, tip = _scene(objects, sensor)
    if kind == "mesh":  # MuJoCo moves the vertices into the frame of the mesh's inertia
        first = [*model.mesh_vertadr, len(model.mesh_vert)]
        objects = [(kind, model.mesh_vert[a:b]) for a, b in zip(first, first[1:], strict=False)]
    membrane = QuasistaticMembrane(sensor)
    places = [_place(item, membrane, rng) for item in objects]
    depths = rng.uniform(0.3e-3, 2.5e-3, count)
    with wp.ScopedDevice(device):
        m = mjw.put_model(model)
        d = mjw.put_data(model, mujoco.MjData(model), nworld=count, nconmax=8, njmax=8)
        touch = mjtactile.warp.bind(model, m, d, [tip])
        for depth in np.arange(0.0, depths.max() + (_HOLD + 1) * _STEP, _STEP):
            now = [
                place.raised(-min(depth, own)) for place, own in zip(places, depths, strict=True)
            ]
            _put(m, d, model, objects, now)
            touch.update(m, d)
        force = -touch.wrench.numpy()[:, 0, 2]
        pressure, status = touch.pressure.numpy()[:, 0], touch.status.numpy()[:, 0]
        grip = touch.membrane_patches.numpy()["grip"]
    rows = []
    for k, (item, place) in enumerate(zip(objects, places, strict=True)):
        exact = _on_the_cpu(membrane, item, place, depths[k])
        if exact is not None:
            if exact[4] < _TORSION_MIN:
                exact[4] = np.nan
            own = np.diag(grip[k, k if kind == "mesh" else 0])
            found = [force[k], pressure[k], own[0], own[1], own[2]]
            with np.errstate(divide="ignore", invalid="ignore"):
                rows.append(np.array(found) / exact - 1)
    errors = np.array(rows).reshape(-1, 5)
    by_name = {
        "force": errors[:, 0],
        "pressure": errors[:, 1],
        "shear": errors[:, 2:4],
        "torsion": errors[np.isfinite(errors[:, 4]), 4],
    }
    return {
        "kind": kind,
        "presses": len(rows),
        "refused": count - len(rows),
        "unsettled": int((status != 0).sum()),
        "rms": {name: float(np.sqrt(np.mean(part**2))) for name, part in by_name.items()},
        "max": {name: float(np.abs(part).max()) for name, part in by_name.items()},
    }


def press_table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the lines of a table in Markdown, in percent."""
    lines = [
        "| object | presses | force, rms / max, % | pressure, % | shear stiffness, % | "
        "torsion, % |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = [f"{100 * row['rms'][name]:.1f} / {100 * row['max'][name]:.1f}" for name in LIMITS]
        lines.append(f"| {row['kind']} | {row['presses']} | {' | '.join(cells)} |")
    return lines


def _sample(kind: str, rng: np.random.Generator) -> tuple[str, Array]:
    """Return kind and sizes, m, of a random object; the vertices of a mesh."""
    if kind == "ball":
        return "sphere", np.array([np.exp(rng.uniform(np.log(4e-3), np.log(30e-3)))])
    if kind in ("capsule", "cylinder"):
        return kind, rng.uniform([3e-3, 3e-3], [8e-3, 10e-3])
    if kind == "box":
        return kind, rng.uniform(3e-3, 8e-3, 3)
    if kind == "ellipsoid":
        return kind, rng.uniform(6e-3, 20e-3, 3)
    points = rng.normal(size=(24, 3))
    points *= rng.uniform(5e-3, 9e-3, 3) / np.linalg.norm(points, axis=1)[:, None]
    return kind, points


def _scene(objects: Sequence[tuple[str, Array]], sensor: str) -> tuple[mujoco.MjModel, Any]:
    """Return a model with one object for all worlds, or with all meshes."""
    if objects[0][0] == "mesh":
        assets = [
            f'<mesh name="m{k}" vertex="{" ".join(map(str, points.ravel()))}"/>'
            for k, (_, points) in enumerate(objects)
        ]
        geoms = [f'<geom type="mesh" mesh="m{k}" mass="0.1"/>' for k in range(len(objects))]
    else:
        assets = []
        kind, size = objects[0]
        geoms = [f'<geom type="{kind}" size="{" ".join(map(str, size))}" mass="0.1"/>']
    bodies = [
        f'<body name="object{k}" pos="0 0 {_AWAY}"><freejoint/>{geom}</body>'
        for k, geom in enumerate(geoms)
    ]
    spec = mujoco.MjSpec.from_string(_SCENE.format(assets="".join(assets), bodies="".join(bodies)))
    mjtactile.configure_options(spec)
    tip = mjtactile.attach(spec, sensor, site="tip", prefix="tip/", effects="-mesh")
    model = spec.compile()
    model.opt.disableflags = 0
    return model, tip


def _obstacle(item: tuple[str, Array], place: _Place) -> Obstacle:
    kind, sizes = item
    if kind == "mesh":
        return QuasistaticMembrane.obstacle("mesh", (), place.p, place.R, data=sizes)
    return QuasistaticMembrane.obstacle(kind, sizes, place.p, place.R)


def _place(
    item: tuple[str, Array], membrane: QuasistaticMembrane, rng: np.random.Generator
) -> _Place:
    """Return a random pose at which an object starts to touch the untouched membrane."""
    room = np.array([membrane.x[-1], membrane.y[-1]]) - _MARGIN
    R = Rotation.from_euler("z", rng.uniform(0, 360), degrees=True)
    if item[0] == "capsule" or (item[0] == "cylinder" and rng.random() < 0.5):
        R = R * Rotation.from_euler("y", 90, degrees=True)
    axis = np.array([*rng.normal(size=2), 0.0])
    tilt = np.deg2rad(rng.uniform(0, _TILT)) * axis / np.linalg.norm(axis)
    place = _Place(
        np.array([*rng.uniform(-room, room), 0.0]), (Rotation.from_rotvec(tilt) * R).as_matrix()
    )
    grid = np.stack(np.meshgrid(membrane.x, membrane.y, indexing="ij"), axis=-1).reshape(-1, 2)
    heights = membrane.obstacle_heights(_obstacle(item, place), grid)
    return place.raised(float((membrane.rest.x[2].ravel() - heights).max()))


def _put(
    m: Any,
    d: Any,
    model: mujoco.MjModel,
    objects: Sequence[tuple[str, Array]],
    places: Sequence[_Place],
) -> None:
    """Write poses and sizes of the objects for the device, without kinematics."""
    sizes = np.tile(model.geom_size.astype(np.float32), (len(places), 1, 1))
    found = {
        name: getattr(d, name).numpy().copy() for name in ("xpos", "xmat", "geom_xpos", "geom_xmat")
    }
    for k, ((kind, size), place) in enumerate(zip(objects, places, strict=True)):
        body = int(model.body("object0").id) + (k if kind == "mesh" else 0)
        geom = int(model.body_geomadr[body])
        found["xpos"][k, body] = found["geom_xpos"][k, geom] = place.p
        found["xmat"][k, body] = found["geom_xmat"][k, geom] = place.R
        if kind != "mesh":
            sizes[k, geom, : len(size)] = size
    for name, values in found.items():
        getattr(d, name).assign(values)
    m.geom_size = type(m.geom_size)(sizes, dtype=m.geom_size.dtype, device=d.xpos.device)


def _on_the_cpu(
    membrane: QuasistaticMembrane, item: tuple[str, Array], place: _Place, depth: float
) -> Array | None:
    """Return force, pressure and sticking stiffness (5,), or None without an equilibrium."""
    state = None
    try:
        for by in np.linspace(0, depth, 11)[1:]:
            state = membrane.solve(_obstacle(item, place.raised(-by)), state)
    except InputError:
        return None
    if state is None or not state.converged:
        return None
    grip = sticking_of(membrane).grip(state.x, state.force).stiffness
    return np.array([state.force_normal, state.gauge_pressure, *np.diag(grip)])
