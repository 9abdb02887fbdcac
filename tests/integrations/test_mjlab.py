"""The sensor of mjlab in mjlab's own scene and simulation, on the CPU.

It runs where mjlab and integrations/mjlab_mjtactile are (docs/how-to/integrations.md).
"""

import re
import runpy
from pathlib import Path

import pytest

pytest.importorskip("mjlab")
pytest.importorskip("mjlab_mjtactile")

import mujoco
import torch
from many_worlds.conftest import linear_solver_stops_at_convergence  # noqa: F401
from mjlab.entity import EntityCfg
from mjlab.scene import Scene, SceneCfg
from mjlab.sim import Simulation, SimulationCfg
from mjlab_mjtactile import MembraneMujocoCfg, MembraneSensorCfg

pytestmark = [pytest.mark.slow(200), pytest.mark.filterwarnings("default")]
EXAMPLE = Path(__file__).resolve().parents[2] / "examples/many_worlds.py"
WORLDS, TIMESTEP, FORCE = 2, 0.002, 0.6


def entities():
    """Return the gripper and the egg of the example, as two entities."""
    scene = runpy.run_path(str(EXAMPLE))["GRIPPER"]
    egg = re.search(r'<body name="egg".*?</body>', scene, re.DOTALL).group(0)
    named = egg.replace("<freejoint/>", '<freejoint name="free"/>')
    files = {
        "robot": (scene.replace(egg, ""), (0.0, 0.0, 0.0)),
        "egg": (f"<mujoco><worldbody>{named}</worldbody></mujoco>", (0.0, 0.0, 0.0231)),
    }
    return {
        name: EntityCfg(
            spec_fn=lambda text=text: mujoco.MjSpec.from_string(text),
            init_state=EntityCfg.InitialStateCfg(pos=at),
        )
        for name, (text, at) in files.items()
    }


def test_a_gripper_of_mjlab_closes_on_an_egg_by_touch():
    """The commands regulate 0.6 N and reach it within 1 %; a reset returns a world to rest."""
    touch = MembraneSensorCfg(name="touch", sites=("robot/left_tip", "robot/right_tip"))
    how = {"num_envs": WORLDS, "env_spacing": 0.0, "entities": entities(), "sensors": (touch,)}
    scene = Scene(SceneCfg(**how), device="cpu")
    cfg = SimulationCfg(nconmax=32, njmax=128, mujoco=MembraneMujocoCfg(timestep=TIMESTEP))
    sim = Simulation(num_envs=WORLDS, cfg=cfg, spec=scene.spec, device="cpu")
    scene.initialize(mj_model=sim.mj_model, model=sim.model, data=sim.data)
    sim.reset()
    scene.reset()
    ctrl = torch.zeros(WORLDS, 3)  # lift, left, right
    for _ in range(700):
        force = -scene["touch"].data.wrench[:, :, 2].mean(dim=1)
        speed = torch.clamp(0.01 * (FORCE - force) / 0.3, -0.02, 0.02)
        ctrl[:, 1:] += speed[:, None] * TIMESTEP
        sim.data.ctrl[:] = ctrl
        sim.step()
        scene.update(TIMESTEP)
    data = scene["touch"].data
    assert -data.wrench[:, :, 2] == pytest.approx(FORCE, rel=0.01)
    assert (data.status == 0).all()
    assert data.area.min() > 2e-5  # of a circle of 5 mm
    scene.reset(torch.tensor([1]))
    assert (scene["touch"].data.wrench[0, :, 2] < -0.5).all()
    assert (scene["touch"].data.wrench[1] == 0).all()
