"""MuJoCo's own `<tactile>` sensor in MuJoCo Warp, on the gripper of `examples/many_worlds.py`.

Both grippers close on the same egg. `<tactile>` reports a dimensionless pressure, a function of the
depth of penetration alone, and sliding speeds at the vertices of a mesh, as many as a membrane has
nodes. It has no forces.
"""

from __future__ import annotations

import runpy
import time
from pathlib import Path
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

import mjtactile
import mjtactile.warp

_EXAMPLE = Path(__file__).resolve().parents[2] / "examples/many_worlds.py"
_TIPS = ("left", "right")
_GRID = (21, 16)
_HALF = (0.02, 0.015)  # half-extents of the taxels, m
_DEPTH = 0.003  # depth of the pad, m; its height is that of a membrane's bulge
_CLOSED = 0.0195  # goal of the jaws, m: pads and membranes touch the egg


def speeds(worlds: int, device: str, steps: int) -> dict[str, Any]:
    """Return physics steps per second of both grippers, and the final values of their sensors."""
    with wp.ScopedDevice(device):
        own, touch = _with_membranes(worlds)
        membranes = _steps_per_second(own, steps)
        other = _with_tactile(worlds)
        tactile = _steps_per_second(other, steps)
    force = -touch.wrench.numpy()[:, :, 2]
    nodes = _GRID[0] * _GRID[1]
    pressure = other[2].sensordata.numpy()[:, :nodes]  # of the first sensor, before its speeds
    return {
        "worlds": worlds,
        "membranes_steps_per_s": membranes,
        "membranes_force_N": float(force.mean()),
        "tactile_steps_per_s": tactile,
        "tactile_max_pressure": float(pressure.max()),
    }


def _scene() -> mujoco.MjSpec:
    spec = mujoco.MjSpec.from_string(runpy.run_path(str(_EXAMPLE))["GRIPPER"])
    mjtactile.configure_options(spec, 0.0025)
    return spec


def _with_membranes(worlds: int) -> tuple[Any, Any]:
    spec = _scene()
    tips = [
        mjtactile.attach(spec, "dense", site=f"{side}_tip", prefix=f"{side}/", effects="-mesh")
        for side in _TIPS
    ]
    own = model, m, d = _put(spec, worlds)
    return own, mjtactile.warp.bind(model, m, d, tips)


def _with_tactile(worlds: int) -> Any:
    spec = _scene()
    x, y = np.meshgrid(*(np.linspace(-half, half, n) for half, n in zip(_HALF, _GRID, strict=True)))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    corners = np.arange(x.size).reshape(x.shape)
    first, right, up = corners[:-1, :-1].ravel(), corners[:-1, 1:].ravel(), corners[1:, :-1].ravel()
    faces = np.column_stack([first, right, up])
    spec.add_mesh(
        name="taxels",
        uservert=points.ravel(),
        userface=faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    for side in _TIPS:
        site = spec.site(f"{side}_tip")
        site.parent.add_geom(
            name=f"{side}_pad",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[*_HALF, _DEPTH / 2],
            pos=site.pos,
            quat=site.quat,
            mass=0.05,
            solref=[0.02, 1.0],
        )
        sensor = spec.add_sensor(name=f"{side}_touch", type=mujoco.mjtSensor.mjSENS_TACTILE)
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_MESH, "taxels"
        sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_GEOM, f"{side}_pad"
    return _put(spec, worlds)


def _put(spec: mujoco.MjSpec, worlds: int) -> tuple[Any, Any, Any]:
    """Return model, and MuJoCo Warp's model and data, with the jaws' goals at the egg."""
    model = spec.compile()
    model.opt.disableflags = 0  # MuJoCo Warp has no `autoreset`
    data = mujoco.MjData(model)
    for side in _TIPS:
        data.ctrl[model.actuator(side).id] = _CLOSED
    mujoco.mj_forward(model, data)
    return model, *_on_device(model, data, worlds)


def _on_device(model: mujoco.MjModel, data: mujoco.MjData, worlds: int) -> tuple[Any, Any]:
    return mjw.put_model(model), mjw.put_data(model, data, nworld=worlds, nconmax=64, njmax=256)


def _steps_per_second(scene: Any, steps: int) -> float:
    """Return the steps of all worlds per second; on a GPU in a CUDA graph."""
    _, m, d = scene
    mjw.step(m, d)  # compiles
    step = lambda: mjw.step(m, d)  # noqa: E731
    if d.qpos.device.is_cuda:
        with wp.ScopedCapture() as capture:
            mjw.step(m, d)
        graph: Any = capture.graph
        step = lambda: wp.capture_launch(graph)  # noqa: E731
    wp.synchronize_device(d.qpos.device)
    start = time.perf_counter()
    for _ in range(steps):
        step()
    wp.synchronize_device(d.qpos.device)
    return steps * d.nworld / (time.perf_counter() - start)
