r"""`attach`: add a tactile sensor to any MuJoCo scene.

    spec = mujoco.MjSpec.from_file("their_robot.xml")
    print(*mjtactile.configure_options(spec), sep="\n")       # changed options, with reasons
    sites = ("left_tip", "right_tip")
    tips = [mjtactile.attach(spec, "dense", site=site, prefix=f"{site}/") for site in sites]
    model = spec.compile()
    data = mujoco.MjData(model)
    # inflated, references taken on the sensor alone
    fingers = [tip.bind(model, data) for tip in tips]
    while data.time < 5:
        mjtactile.step(model, data, fingers)  # gas, mj_step, images when they are due
        touch = fingers[0].touch                               # of the newest image, with its age

The site's frame becomes the sensor frame S. Its origin is the center of the flat membrane, z points
outward.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco

from mjtactile.core.design import SensorDesign, load_sensor, require_valid
from mjtactile.core.effect_names import Effect
from mjtactile.core.errors import InputError
from mjtactile.core.signature_checks import above, not_below, validated
from mjtactile.plugin.sim_finger import OUTPUTS, SimFinger
from mjtactile.sim.attach import Attachment, attach_membrane
from mjtactile.sim.sensor.effect_switches import CAMERA, PHYSICS, effects_named

_MIN_MESH = 8  # vertices along a side: the shipped sensors' references are in balance from there


@dataclass(frozen=True, eq=False)
class AttachedSensor:
    """Sensor attached to a spec. `bind` connects it to each model compiled from that spec.

    Attributes:
        membrane: The attached membrane.
        carrier_contact: False if `bind` excludes the carrier's geoms that the membrane can reach.
    """

    membrane: Attachment
    carrier_contact: bool = True

    @validated(seed=not_below(0))
    def bind(self, model: mujoco.MjModel, data: mujoco.MjData, *, seed: int = 0) -> SimFinger:
        """Make the sensor ready to run: inflated, sealed, its references taken on the sensor alone.

        It finishes the model (pre-stretch, contact stiffness) and writes the membrane's joints in
        `data`. A geom with a `conaffinity` for `contype` 1, but no `contype`, touches the membrane
        as it touches a default geom. The rest of the scene is unchanged. One model carries one
        bound state. Bind again after `spec.recompile`, or to restart.

        Args:
            model: Compiled from the spec.
            data: Of that model.
            seed: Of the camera's noise.

        Returns:
            The sensor at run time.

        Raises:
            InputError: The model's options cannot carry the sensor, or it was not compiled from the
                spec.

        Warns:
            UserWarning: Objects can rest on a geom of the carrier through the membrane, a geom
                makes contact by a `<pair>` only, or an object has a margin or a negative gap.
        """
        finger = SimFinger(self.membrane, model, data, seed, self.carrier_contact)
        for text in finger.notes:
            warnings.warn(f"finger {finger.name!r}: {text}", stacklevel=2)
        return finger


@validated(mass=above(0))
def attach(
    spec: mujoco.MjSpec,
    sensor: SensorDesign | str | Path,
    *,
    site: mujoco.MjsSite | str,
    prefix: str = "tactile_",
    mesh: tuple[int, int] | None = None,
    mass: float = 0.05,
    contact: str = "auto",
    effects: Collection[str] | str | None = None,
    carrier_contact: bool = True,
) -> AttachedSensor:
    """Attach a sensor to a scene, with `user` sensors for its estimates.

    Args:
        spec: The scene.
        sensor: A design, a shipped name or a TOML file.
        site: Mounting site. Its frame becomes the sensor frame S: the origin is the center of the
            flat membrane, z points outward.
        prefix: Prefix of all names in the scene; it distinguishes several sensors.
        mesh: Number of vertices along x and y.
        mass: Mass of frame, glass and camera, kg.
        contact: Contact geometry of the membrane: its "vertices", its triangles ("elements"),
            "both", or "auto" for a choice by the scene's smallest feature.
        effects: Names that `mjtactile effects` lists; None: all of physics and camera. A text such
            as "-mesh" or "+bending,-friction" changes this default. The sensing pipeline always
            runs: synthetic touch is available in grasps only.
        carrier_contact: Keep the contacts of geoms to which the sensor is fixed. False excludes
            those in the chamber or in front of the frame: there, objects would rest on them instead
            of the membrane.

    Returns:
        The sensor, to `bind` to the compiled model.

    Raises:
        InputError: An unknown site, a prefix already in use, a sensor that cannot be simulated or
            sensed with, or options of `spec` that the sensor cannot use (`configure_options` sets
            them).
    """
    design = load_sensor(sensor)
    require_valid(design)
    if mesh is not None and min(mesh) < _MIN_MESH:
        raise InputError(
            f"{mesh} vertices give a bulge that sensing rejects as disturbed; at least "
            f"({_MIN_MESH}, {_MIN_MESH}) are needed",
            source="attach",
            field="mesh",
        )
    options: Any = {"prefix": prefix, "mesh": mesh, "mass": mass, "contact": contact}
    named = effects_named("auto" if effects is None else effects, PHYSICS | CAMERA)
    on = {*named, Effect.PIPELINE}
    membrane = attach_membrane(spec, design, site=site, effects=on, **options)
    # stage "none": MuJoCo fills the others with zeros in every step
    kind: Any = {"type": mujoco.mjtSensor.mjSENS_USER, "needstage": mujoco.mjtStage.mjSTAGE_NONE}
    for name, size in OUTPUTS.items():
        spec.add_sensor(name=prefix + name, dim=size, **kind)
    return AttachedSensor(membrane, carrier_contact)
