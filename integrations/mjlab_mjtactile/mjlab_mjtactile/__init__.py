# pyright: reportMissingImports=false
"""`MembraneSensorCfg`: tactile membranes as a sensor of mjlab.

    touch = MembraneSensorCfg(name="touch", sites=("robot/left_tip", "robot/right_tip"))
    scene = SceneCfg(num_envs=4096, entities={...}, sensors=(touch,))
    sim = SimulationCfg(mujoco=MembraneMujocoCfg(timestep=0.002))
    ...
    force = -env.scene["touch"].data.wrench[:, :, 2]  # N, (worlds, fingers)

mjlab captures its CUDA graphs before it initializes sensors: call `env.sim.create_graph()` once
after the environment is created.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import torch
import warp as wp
from mjlab.sensor import Sensor, SensorCfg
from mjlab.sim import MujocoCfg

import mjtactile
import mjtactile.warp

AUTORESET = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


@dataclass
class MembraneMujocoCfg(MujocoCfg):
    """Options of MuJoCo with the integrator and the solver of the membranes."""

    def apply(self, model: mujoco.MjModel) -> None:
        super().apply(model)
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
        model.opt.solver = mujoco.mjtSolver.mjSOL_CG


@dataclass(frozen=True)
class MembraneData:
    """Tensors that share memory with the device; the next step overwrites them.

    Attributes:
        wrench: N and N m on the membranes, about the origin of S (worlds, fingers, 6).
        pressure: Gauge pressure, Pa (worlds, fingers).
        area: Contact area, m^2 (worlds, fingers).
        center: Center of contact in S, m (worlds, fingers, 3).
        slides: 1 at the friction limit (worlds, fingers).
        slid: Sliding distance, m (worlds, fingers).
        status: 0 equilibrium, 1 not yet, 2 and more: rejected (worlds, fingers).
    """

    wrench: torch.Tensor
    pressure: torch.Tensor
    area: torch.Tensor
    center: torch.Tensor
    slides: torch.Tensor
    slid: torch.Tensor
    status: torch.Tensor


@dataclass
class MembraneSensorCfg(SensorCfg):
    """Membranes of one design on sites of the scene, whose z axes point outward.

    Attributes:
        sites: Names of the sites, with the prefix of their entity.
        sensor: Shipped name of the design, or a TOML file.
    """

    sites: tuple[str, ...] = ()
    sensor: str = "dense"

    def build(self) -> MembraneSensor:
        return MembraneSensor(self)


class MembraneSensor(Sensor[MembraneData]):
    """Membranes in all worlds; `MembraneSensorCfg` makes it. A scene has one of them."""

    def __init__(self, cfg: MembraneSensorCfg):
        super().__init__()
        self.cfg = cfg
        self._tips: list[mjtactile.AttachedSensor] = []
        self._touch: Any = None
        self._mask: Any = None

    def edit_spec(self, scene_spec: mujoco.MjSpec, entities: dict[str, Any]) -> None:
        """Attach the membranes. Raises InputError for an unknown site."""
        mjtactile.configure_options(scene_spec)
        self._tips = [
            mjtactile.attach(
                scene_spec,
                self.cfg.sensor,
                site=site,
                prefix=f"{self.cfg.name}/{number}/",
                effects="-mesh",
            )
            for number, site in enumerate(self.cfg.sites)
        ]
        scene_spec.option.disableflags &= ~AUTORESET  # which MuJoCo Warp does not have

    def initialize(self, mj_model: mujoco.MjModel, model: Any, data: Any, device: str) -> None:
        """Connect the membranes to the worlds; mjlab passes wrappers of MuJoCo Warp's structs."""
        m, d = (getattr(item, "struct", item) for item in (model, data))
        self._touch = mjtactile.warp.bind(mj_model, m, d, self._tips)
        self._mask = wp.zeros(d.nworld, dtype=bool, device=device)

    def reset(self, env_ids: torch.Tensor | slice | None = None) -> None:
        """Return the membranes of some worlds, or of all, to rest without contact."""
        super().reset(env_ids)
        mask = wp.to_torch(self._mask)
        mask[:] = env_ids is None
        if env_ids is not None:
            mask[env_ids] = True
        self._touch.reset(self._mask)

    def _compute_data(self) -> MembraneData:
        names = MembraneData.__dataclass_fields__
        return MembraneData(**{name: wp.to_torch(getattr(self._touch, name)) for name in names})
