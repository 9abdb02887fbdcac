"""A learned policy as a controller: `MJTACTILE_POLICY=policy.npz mjtactile grasp --controller
policy` (docs/how-to/train.md).

The file is that of `mjtactile.save_policy`, or FILE.onnx, which needs onnxruntime.
"""

import os
from functools import cache
from pathlib import Path

from mjtactile.types import Command, Observation, load_policy

POLICY = Path(os.environ.get("MJTACTILE_POLICY", Path(__file__).with_name("policy.npz")))
load = cache(load_policy)  # one file is read once
if "MJTACTILE_POLICY" in os.environ:
    load(POLICY)  # a broken file is refused before the rig is opened


def step(observation: Observation) -> Command:
    return load(POLICY).command(observation)
