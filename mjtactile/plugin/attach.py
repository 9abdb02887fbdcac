"""`attach`: put a sensor that feels into any MuJoCo scene.

    spec = mujoco.MjSpec.from_file("their_robot.xml")
    print(*mjtactile.configure_options(spec), sep="\\n")       # what it changed, and why
    sites = ("left_tip", "right_tip")
    tips = [mjtactile.attach(spec, "dense", site=site, prefix=f"{site}/") for site in sites]
    model = spec.compile()
    data = mujoco.MjData(model)
    # inflated, references taken on the sensor alone
    fingers = [tip.bind(model, data) for tip in tips]
    while data.time < 5:
        mjtactile.step(model, data, fingers)  # gas, mj_step, images when they are due
        touch = fingers[0].touch                               # the newest image's, with its age

The site's frame becomes the sensor's frame S: origin in the middle of the flat membrane, z outward.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import mujoco

from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError
from mjtactile.plugin.sim_finger import OUTPUTS, SimFinger
from mjtactile.sim.attach import Attachment, attach_membrane
from mjtactile.sim.sensor.effect_switches import CAMERA, PHYSICS, Effect

_MIN_MESH = 8  # vertices along a side: the shipped sensors' references are in balance from there


@dataclass(frozen=True, eq=False)
class AttachedSensor:
    """Where `attach` put a sensor; `bind` it to each model compiled from that spec.

    Attributes:
        membrane: What was put there.
    """

    membrane: Attachment

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData, *, seed: int = 0) -> SimFinger:
        """Make the sensor ready to run: inflated, sealed, its references taken on the sensor alone.

        It finishes the model (pre-stretch, contact stiffness) and writes the membrane's joints in
        `data`; nothing else of the scene is touched. One model carries one bound state: bind again
        after `spec.recompile`, or to start over.

        Args:
            model: Compiled from the spec.
            data: Of that model.
            seed: Of the camera's noise.

        Returns:
            The sensor at run time.

        Raises:
            InputError: The model's options cannot carry the sensor, or it was not compiled from the
                spec.
        """
        return SimFinger(self.membrane, model, data, seed)


def attach(
    spec: mujoco.MjSpec,
    sensor: SensorDesign | str | Path,
    *,
    site: mujoco.MjsSite | str,
    prefix: str = "tactile_",
    mesh: tuple[int, int] | None = None,
    mass: float = 0.05,
    contact: str = "auto",
    effects: Collection[str] = PHYSICS | CAMERA,
) -> AttachedSensor:
    """Attach a sensor to a scene, with `user` sensors for what it feels.

    Args:
        spec: The scene.
        sensor: A design, a shipped name or a TOML file.
        site: Where; its frame becomes the sensor's frame S: the origin in the middle of the flat
            membrane, z outward.
        prefix: Of all names in the scene; keeps several sensors apart.
        mesh: Number of vertices along x and y.
        mass: kg of frame, glass and camera.
        contact: What of the membrane touches: its "vertices", its triangles ("elements"), "both",
            or "auto" by the scene's smallest feature.
        effects: Names that `mjtactile effects` lists. The chain always feels: touch can be drawn
            in grasps only.

    Returns:
        What to `bind` to the compiled model.

    Raises:
        InputError: An unknown site, a prefix already used, a sensor that cannot be simulated or
            felt with, or options of `spec` that cannot carry it (`configure_options` sets them).
    """
    design = load_sensor(sensor)
    if mesh is not None and min(mesh) < _MIN_MESH:
        raise InputError(
            f"{mesh} vertices make a bulge that sensing takes for a disturbed one; at least "
            f"({_MIN_MESH}, {_MIN_MESH})",
            source="attach",
            field="mesh",
        )
    placed = attach_membrane(
        spec,
        design,
        site=site,
        prefix=prefix,
        mesh=mesh,
        mass=mass,
        contact=contact,
        effects={*effects, Effect.CHAIN},
    )
    for name, size in OUTPUTS.items():
        # stage "none": MuJoCo fills the others with zeros in every step
        spec.add_sensor(
            name=prefix + name,
            type=mujoco.mjtSensor.mjSENS_USER,
            dim=size,
            needstage=mujoco.mjtStage.mjSTAGE_NONE,
        )
    return AttachedSensor(placed)
