"""A learned policy as a controller: `MJTACTILE_POLICY=policy.npz mjtactile grasp --controller
policy` (docs/how-to/train.md).

A numpy archive with w0, b0, w1, b1, … is a network with tanh between its layers; a file.onnx needs
onnxruntime.
"""

import os
from functools import cache
from pathlib import Path

import numpy as np

from mjtactile.types import Command, Observation, command_from_action, policy_observation

POLICY = Path(os.environ.get("MJTACTILE_POLICY", Path(__file__).with_name("policy.npz")))


@cache
def load(path: Path):
    """The function from a vector to an action."""
    if path.suffix == ".onnx":
        import onnxruntime  # pyright: ignore[reportMissingImports]

        session = onnxruntime.InferenceSession(path)
        name = session.get_inputs()[0].name
        return lambda x: np.asarray(session.run(None, {name: x[None]})[0])[0]
    with np.load(path) as file:
        layers = [(file[f"w{k}"], file[f"b{k}"]) for k in range(len(file.files) // 2)]

    def act(x):
        for k, (w, b) in enumerate(layers):
            x = w @ (np.tanh(x) if k else x) + b
        return x

    return act


def step(observation: Observation) -> Command:
    return command_from_action(observation, load(POLICY)(policy_observation(observation)))
