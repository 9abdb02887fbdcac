"""Tests of the rest reference: refused with contact, accepted for sensors with other parameters."""

from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.core.errors import DeviceError
from mjtactile.rig.as_built_sensor import AsBuiltSensor, camera_pose, true_design
from mjtactile.rig.registry import build_rig
from mjtactile.runtime.session import Session
from mjtactile.sensing.stateful_pipeline import StatefulPipeline
from mjtactile.sim.rendering.renderer import Renderer
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

IMAGES = 6


def references(
    sensor,
    own,
    pressure=1000.0,
    *,
    indenter="sphere:8",
    depth=0.0,
    at=(0.0, 0.0),
    pre_stretch=0.0,
    seed=0,
):
    """Return the pipeline of the sensor file with both references of an as-built sensor `own`,
    which is pressed by `depth` m during the second."""
    design = load_sensor(sensor)
    true = true_design(design, own)
    true = replace(
        true, membrane=replace(true.membrane, pre_stretch=true.membrane.pre_stretch + pre_stretch)
    )
    world = PressWorld(true, Indenter.parse(indenter), at=at)
    renderer = Renderer(true, seed=seed, pose=camera_pose(design, own))
    pipeline = StatefulPipeline.of(design)

    def images():
        return [renderer.render(*world.marker_poses(0), world.time) for _ in range(IMAGES)]

    world.inflate(0.0, seal=False)
    pipeline.measure_flat_reference(images())
    world.inflate(pressure, seal=False)
    if depth:
        world.press(depth)
    pipeline.measure_rest_reference(images(), pressure)
    return pipeline


def random_as_built(rng):
    """Sample stiffness within 30 %, focal length 3 %, center 6 px, k1 0.04, a displaced and rotated
    camera, larger markers."""

    def off(maximum):
        return float(rng.uniform(-maximum, maximum))

    return AsBuiltSensor(
        "left",
        focal_fraction=off(0.03),
        center=(off(6), off(6)),
        k1=-0.05 + off(0.04),
        shift=(off(4e-4), off(4e-4), off(4e-4)),
        tilt=(off(0.017), off(0.017), off(0.017)),
        stiffness_fraction=off(0.3),
        radius=off(2e-5),
    )


@pytest.mark.parametrize("sensor", ["dense", "paper16"])
def test_as_built_sensors_are_not_refused(sensor):
    rng = np.random.default_rng(3)
    for seed in range(5):
        references(
            sensor,
            random_as_built(rng),
            float(rng.choice([600.0, 1000.0, 1500.0])),
            pre_stretch=rng.uniform(-0.02, 0.02),
            seed=seed,
        )


@pytest.mark.parametrize("sensor", ["dense", "paper16"])
@pytest.mark.parametrize(
    ("indenter", "depth", "at"),
    [
        ("box:60", 0.8e-3, (0.0, 0.0)),
        ("box:12", 0.8e-3, (0.0, 0.0)),
        ("sphere:16", 1e-3, (0.0, 0.0)),
        ("sphere:10", 0.8e-3, (8e-3, 5e-3)),
    ],
)
def test_contact_during_the_reference_is_detected(sensor, indenter, depth, at):
    """A contact of 0.09 to 0.13 N during the references is detected.

    Undetected, it would be estimated as a stiffer membrane, with force errors larger than that.
    """
    with pytest.raises(DeviceError, match="remove any contact"):
        references(
            sensor,
            AsBuiltSensor("left", stiffness_fraction=-0.1),
            indenter=indenter,
            depth=depth,
            at=at,
        )


WIDE = """<mujoco model="wide"><custom><numeric name="break_force_N" data="50"/><numeric name="grasp_height_m" data="0.03"/>
  <numeric name="rotation_deg" data="0.01"/><text name="material" data="solid"/></custom><worldbody>
  <body name="object" pos="0 0 0.03"><freejoint/><geom type="box" size="0.039 0.03 0.03" mass="0.1"/></body>
</worldbody></mujoco>"""


def test_a_box_that_fills_the_open_jaws_is_found(tmp_path):
    """A box of 78 mm between jaws that open to 80 is detected; undetected, the estimate was 0.195 N
    of 0.454."""
    path = tmp_path / "wide.xml"
    path.write_text(WIDE)
    rig = build_rig("sim", load_sensor("dense"), object_name=str(path), seed=0)
    try:
        with pytest.raises(DeviceError, match="remove any contact"):
            Session(rig).take_references()
    finally:
        rig.close()
