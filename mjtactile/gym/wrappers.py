"""Wrapper that adapts `mjtactile/Grasp-v0` to standard reinforcement learning algorithms.

It scales observations to about one and centers actions on a useful value. It repeats actions so
that a grasp has about thirty decisions. `save_policy` writes the file format of
`controllers/policy.py`, in the units of the environment.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjtactile.core import policy_file
from mjtactile.core.errors import InputError
from mjtactile.core.policy import policy_observation_names

_UNITS = {"N": 1.0, "Nm": 5e-3, "m": 0.04, "s": 1.0}
_OWN = {"speed_m_s": 0.05, "goal_ahead_m": 0.004}
# Value of each observation component that is scaled to 1
SCALE = np.array(
    [_OWN.get(n, _UNITS.get(n.rpartition("_")[2], 1.0)) for n in policy_observation_names()]
)
# A learner's 0 closes slowly, with 1 N, and stays down: noise about it neither crushes nor rises
# before anything is held
MIDDLE = np.array([-0.2, -0.75, -0.4])
SPAN = np.array([0.8, 0.15, 1.0])


class ActionRepeatScaling(gymnasium.Wrapper):
    """Wrapper that repeats each action for several steps and scales observations and actions.

    Args:
        env: `mjtactile/Grasp-v0` with observation "wrench".
        steps: Number of environment steps (33 ms each) per action; 8 give about thirty decisions
            per grasp.
        fear: Maximum penalty of a single step. At 1, some learners stop lifting.
    """

    def __init__(self, env: gymnasium.Env, steps: int = 8, fear: float = 0.3):
        super().__init__(env)
        self._steps = steps
        self._fear = fear
        maximum = (env.observation_space.high / SCALE).astype(np.float32)  # pyright: ignore[reportAttributeAccessIssue]
        self.observation_space = gymnasium.spaces.Box(-maximum, maximum, dtype=np.float32)
        low, high = ((end - MIDDLE) / SPAN for end in (-1.0, 1.0))
        self.action_space = gymnasium.spaces.Box(low, high, dtype=np.float64)

    def reset(self, **how: Any) -> tuple[NDArray, dict[str, Any]]:
        shown, info = self.env.reset(**how)
        return (shown / SCALE).astype(np.float32), info

    def step(self, action: ArrayLike) -> tuple[NDArray, float, bool, bool, dict[str, Any]]:
        """Repeat the action for `steps` steps, or to the end of the episode, and sum the
        rewards."""
        scaled = MIDDLE + SPAN * np.asarray(action)
        total = 0.0
        for _ in range(self._steps):
            shown, reward, terminated, truncated, info = self.env.step(scaled)
            total += max(float(reward), -self._fear)
            if terminated or truncated:
                break
        return (shown / SCALE).astype(np.float32), total, terminated, truncated, info


def save_policy(
    path: str | Path,
    layers: Sequence[tuple[ArrayLike, ArrayLike]],
    *,
    activation: str | None = None,
) -> None:
    """Write a network that learned behind `ActionRepeatScaling`.

    Args:
        path: File, .npz.
        layers: Weights (outputs, inputs) and biases (outputs,) of each layer, first to last.
        activation: Function between the layers: "tanh" or "relu".

    Raises:
        InputError: Shapes do not match, a value is not finite, or the activation is unknown.
    """
    policy_file.save_policy(
        path,
        layers,
        activation=activation,
        input_scale=SCALE,
        output_center=MIDDLE,
        output_scale=SPAN,
    )


def policy_layers(path: str | Path) -> list[tuple[NDArray, NDArray]]:
    """Read the layers of a file of `save_policy`, to continue learning.

    Args:
        path: File, .npz.

    Returns:
        Weights (outputs, inputs) and biases (outputs,) of each layer, as they were saved.

    Raises:
        InputError: The file is missing or broken, or the policy has a memory.
    """
    policy = policy_file.load_policy(path)
    if policy.unit is not None:
        text = "has a memory, which this learner does not have"
        raise InputError(text, source=path, choices=["a policy without a RecurrentUnit"])
    layers = [(np.array(w), np.array(b)) for w, b in policy.layers]
    if not layers:
        raise InputError("has no layers", source=path, choices=["FILE.npz"])
    w, b = layers[0]
    layers[0] = (w * SCALE, b)
    w, b = layers[-1]
    layers[-1] = (w / SPAN[:, None], (b - MIDDLE) / SPAN)
    return layers
