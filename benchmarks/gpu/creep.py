"""Creep of boxes that two sensors hold by friction, on the device.

At rest a held object must not move. The speed is that of 10 s, after the first 2 s under weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

MASSES = (0.01, 0.03, 0.1, 0.2, 0.3)
"""Mass of the box in each world, kg."""
STEPS = (2.08e-3, 4.17e-3)
"""Time steps, s."""
_FRICTION = 0.8
_MARGIN = 1.6  # grip over the required one
_GRIP_MIN = 0.3  # N
_GRAVITY = 9.81
_PHASES = (1.0, 2.0, 10.0)  # grip without weight, weight, measurement, s
_SCENE = """
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>
    <body name="left">
      <joint name="left" type="slide" axis="0 0 1" damping="20"/>
      <geom size="0.005" mass="0.2" contype="0" conaffinity="0"/>
      <site name="left"/>
    </body>
    <body name="right" pos="0 0 0.0352" euler="180 0 0">
      <joint name="right" type="slide" axis="0 0 1" damping="20"/>
      <geom size="0.005" mass="0.2" contype="0" conaffinity="0"/>
      <site name="right"/>
    </body>
    <body name="object" pos="0 0 0.0176">
      <freejoint/>
      <geom type="box" size="0.008 0.006 0.012" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor joint="left"/><motor joint="right"/></actuator>
</mujoco>
"""


def creep(
    step: float,
    device: str,
    masses: Sequence[float] = MASSES,
    phases: tuple[float, float, float] = _PHASES,
) -> dict[str, Any]:
    """Measure the creep of boxes held by friction.

    Args:
        step: Time step, s.
        device: Device of Warp.
        masses: Mass of the box in each world, kg.
        phases: Times of grip without weight, of weight, and of the measurement, s.

    Returns:
        "step_ms", "masses_g", "shear_N" per finger and "speed_um_s" of each world, and the number
        of "rejected" solutions.
    """
    import mujoco_warp as mjw
    import warp as wp

    import mjtactile.warp

    spec = mujoco.MjSpec.from_string(_SCENE)
    mjtactile.configure_options(spec, step)
    sensors = [
        mjtactile.attach(spec, "dense", site=side, prefix=f"{side}/", effects="-mesh")
        for side in ("left", "right")
    ]
    model = spec.compile()
    model.opt.disableflags = 0  # MuJoCo Warp has no `autoreset`
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    worlds = len(masses)
    mass = np.asarray(masses)
    grip = np.maximum(_GRIP_MIN, _MARGIN * mass * _GRAVITY / 2 / _FRICTION)
    with wp.ScopedDevice(device):
        m = mjw.put_model(model)
        d = mjw.put_data(model, data, nworld=worlds, nconmax=32, njmax=96)
        touch = mjtactile.warp.bind(model, m, d, sensors)
        touch.friction.fill_(_FRICTION)
        _set_mass(m, model.body("object").id, mass)
        d.ctrl.assign(np.stack([grip, grip], axis=1).astype(np.float32))
        mjw.step(m, d)  # compiles; a capture cannot
        with wp.ScopedCapture() as capture:
            mjw.step(m, d)
        graph: Any = capture.graph

        def run(duration: float) -> Any:
            for _ in range(round(duration / step)):
                wp.capture_launch(graph)
            return d.qpos.numpy()[:, 2:5].copy()

        run(phases[0])
        m.opt.gravity.assign(np.array([[-_GRAVITY, 0.0, 0.0]], np.float32))
        start = run(phases[1])
        moved = np.linalg.norm(run(phases[2]) - start, axis=1)
        wrench = touch.wrench.numpy()
        rejected = touch.failures()
    return {
        "step_ms": 1e3 * step,
        "masses_g": (1e3 * mass).tolist(),
        "shear_N": np.abs(wrench[:, :, 0]).mean(axis=1).tolist(),
        "speed_um_s": (1e6 * moved / phases[2]).tolist(),
        "rejected": int(rejected),
    }


def _set_mass(m: Any, body: int, mass: Any) -> None:
    """Give the body another mass in each world; the compiled one is 1 kg."""
    import warp as wp

    masses, inertia = m.body_mass.numpy(), m.body_inertia.numpy()
    masses = masses.repeat(len(mass) // len(masses), axis=0)
    inertia = inertia.repeat(len(mass) // len(inertia), axis=0)
    masses[:, body] = mass
    inertia[:, body] *= mass[:, None]
    m.body_mass = wp.array(masses.astype(np.float32), dtype=float)
    m.body_inertia = wp.array(inertia.astype(np.float32), dtype=wp.vec3)


def creep_lines(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return the lines of a table."""
    lines = [
        "",
        "Boxes held by friction for 10 s, with 1.6 times the required force:",
        "",
        "| step, ms | mass, g | creep at most, um/s |",
        "|---|---|---|",
    ]
    return lines + [
        f"| {row['step_ms']:.2f} | {min(row['masses_g']):.0f} to {max(row['masses_g']):.0f} | "
        f"{max(row['speed_um_s']):.3f} |"
        for row in rows
    ]
