# pyright: reportMissingImports=false
"""`--env.type=mjtactile`: the grasp environment for lerobot-train and lerobot-eval.

LeRobot finds it by `--env.discover_packages_path=lerobot_env_mjtactile`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE

import mjtactile
import mjtactile.gym

FINGERS = ("left", "right")
_STATE = len(mjtactile.policy_observation_names(len(FINGERS)))


def _features(height: int = 480, width: int = 640) -> dict[str, PolicyFeature]:
    images = {finger: PolicyFeature(FeatureType.VISUAL, (height, width, 3)) for finger in FINGERS}
    return {
        "action": PolicyFeature(FeatureType.ACTION, (3,)),
        "agent_pos": PolicyFeature(FeatureType.STATE, (_STATE,)),
        **images,
    }


@EnvConfig.register_subclass("mjtactile")
@dataclass
class MjtactileEnvConfig(EnvConfig):
    """Settings of the environment; object, sensor and rig are those of `mjtactile grasp`."""

    task: str | None = "Grasp-v0"
    fps: int = 30
    object: str = "egg"
    sensor: str = "dense"
    rig: str = "sim"
    episode_length: int = 600
    features: dict[str, PolicyFeature] = field(default_factory=_features)
    features_map: dict[str, str] = field(
        default_factory=lambda: {
            "action": ACTION,
            "agent_pos": OBS_STATE,
            **{finger: f"{OBS_IMAGES}.{finger}" for finger in FINGERS},
        }
    )

    @property
    def package_name(self) -> str:
        return "lerobot_env_mjtactile"

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        return {
            "object": self.object,
            "sensor": self.sensor,
            "rig": self.rig,
            "max_episode_steps": self.episode_length,
        }


class Grasp(gymnasium.Wrapper):
    """`mjtactile/Grasp-v0` with LeRobot's names of observations, and `is_success`."""

    task = task_description = "grasp the object, lift it, hold it and set it down"

    def __init__(self, **options: Any):
        super().__init__(
            gymnasium.make(
                "mjtactile/Grasp-v0",
                observation="image",
                render_mode="rgb_array",
                disable_env_checker=True,
                **options,
            )
        )
        spaces = self.env.observation_space
        count, height, width = spaces["image"].shape  # type: ignore[index]
        image = gymnasium.spaces.Box(0, 255, (height, width, 3), np.uint8)
        pixels = gymnasium.spaces.Dict(dict.fromkeys(FINGERS[:count], image))
        self.observation_space = gymnasium.spaces.Dict(
            {"agent_pos": spaces["wrench"], "pixels": pixels}  # type: ignore[index]
        )

    def reset(self, **options: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode."""
        observation, info = self.env.reset(**options)
        return _named(observation), info | {"is_success": False}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the simulation by one camera period."""
        observation, reward, ended, cut, info = self.env.step(action)
        success = {"is_success": info.get("outcome") == "held"}
        return _named(observation), reward, ended, cut, info | success


def _named(observation: dict[str, Any]) -> dict[str, Any]:
    shots = [np.repeat(grey[..., None], 3, axis=2) for grey in observation["image"]]
    return {"agent_pos": observation["wrench"], "pixels": dict(zip(FINGERS, shots, strict=False))}


gymnasium.register("lerobot_env_mjtactile/Grasp-v0", entry_point="lerobot_env_mjtactile:Grasp")
