"""Force errors after changes of the gas, in a user's scene, against the simulated contact force."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import mujoco
import numpy as np

import mjtactile
from benchmarks.camera_faults.error_statistics import FAR_N, FAR_SD
from mjtactile import SimFinger

RADIUS = 12e-3
# kg of a ball on an upward sensor: 0.6 N
MASS = 0.061
# durations before and after the change, s
BEFORE = 0.8
AFTER = 2.0
FAULTS: dict[str, Callable[[SimFinger], None]] = {
    "valve to 0.5 kPa": lambda finger: finger.sensor.open_valve(500.0),
    "valve to 2 kPa": lambda finger: finger.sensor.open_valve(2000.0),
    "valve to ambient": lambda finger: finger.sensor.open_valve(0.0),
    "puncture": lambda finger: finger.sensor.puncture(1e-9),
    "leak of 0.03 mL/(s kPa)": lambda finger: finger.sensor.puncture(0.03e-9),
    "warming by 3 K": lambda finger: finger.sensor.warm(1.5),
}


def rows(quick: bool = False) -> list[dict[str, Any]]:
    """Measure the errors of each fault without load and under a ball."""
    names = list(FAULTS)[:: 3 if quick else 1]
    return [
        {"fault": name, "held": held, **apply_gas_change(FAULTS[name], held)}
        for name in names
        for held in (False, True)
    ]


def apply_gas_change(fault: Callable[[SimFinger], None], held: bool) -> dict[str, Any]:
    """Compute the force errors after the change, over images whose status is ok."""
    model, data, finger = scene(MASS if held else None)
    errors(model, data, finger, BEFORE)
    fault(finger)
    off, sd = errors(model, data, finger, AFTER).T
    known = np.isfinite(off)
    far = (np.abs(off) > FAR_SD * sd) & (np.abs(off) > FAR_N) & known
    return {
        "images": len(off),
        "ok": int(known.sum()),
        "far": int(far.sum()),
        "rms_N": float(np.sqrt(np.nanmean(off**2))),
        "worst_N": float(np.nanmax(np.abs(off))),
        "worst_later_N": float(np.nanmax(np.abs(off[len(off) // 4 :]))),
    }


def scene(mass: float | None) -> tuple[mujoco.MjModel, mujoco.MjData, SimFinger]:
    """Build a scene with an upward sensor, and a ball on it if `mass`, kg, is given.

    The ball can only move vertically.
    """
    spec = mujoco.MjSpec()
    mjtactile.configure_options(spec)
    tip = mjtactile.attach(spec, "dense", site=spec.worldbody.add_site(name="tip"), prefix="f/")
    if mass is not None:
        ball = spec.worldbody.add_body(name="ball", pos=[0, 0, RADIUS + 0.006])
        ball.add_joint(name="z", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], damping=2.0)
        ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0, 0], mass=mass)
    model = spec.compile()
    data = mujoco.MjData(model)
    return model, data, tip.bind(model, data)


def errors(
    model: mujoco.MjModel, data: mujoco.MjData, finger: SimFinger, seconds: float
) -> np.ndarray:
    """Return force error and its sd, N, of each image (n, 2); the error is NaN where unknown."""
    ball = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, "z")
    found = []
    end = data.time + seconds
    last = finger.touch.time
    while data.time < end:
        mjtactile.step(model, data, [finger])
        touch = finger.touch
        if touch.time <= last:
            continue
        last = touch.time
        true = 0.0 if ball < 0 else float(data.qfrc_constraint[model.jnt_dofadr[ball]])
        off = touch.force_normal - true if touch.status == "ok" else np.nan
        found.append((off, touch.force_normal_sd))
    return np.array(found)


def table(found: list[Mapping[str, Any]]) -> list[str]:
    """Format the rows as lines of a Markdown table."""
    lines = [
        "| gas fault | force error, N, without load: rms / worst (from 0.5 s) | under a ball of "
        "0.6 N | ok | far |",
        "|---|---|---|---|---|",
    ]
    for fault in dict.fromkeys(row["fault"] for row in found):
        rows = [row for row in found if row["fault"] == fault]
        cells = [
            f"{row['rms_N']:.3f} / {row['worst_N']:.3f} ({row['worst_later_N']:.3f})"
            for row in rows
        ]
        ok, images, far = (sum(row[key] for row in rows) for key in ("ok", "images", "far"))
        lines.append(f"| {fault} | {' | '.join(cells)} | {ok} of {images} | {far} |")
    return lines
