"""Recurrent actor of PyTorch, and its fit to a teacher's actions.

It needs the extra `learn`; no other module imports it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import torch  # pyright: ignore[reportMissingImports]
from torch import nn  # pyright: ignore[reportMissingImports]

from mjtactile.core.policy_file import save_policy
from mjtactile.core.recurrent_policy import UNIT_ARRAYS, RecurrentUnit
from mjtactile.core.types import Array
from mjtactile.gym.imitation import INPUT_SCALE

UNITS = 64  # of the state, and of the hidden layer
ACTION_SCALE = (0.1, 1.0, 0.3)  # action of an output 1
# below it, the loss is quadratic, above it logarithmic: the hold needs small actions exactly
_LOSS_SCALE = torch.tensor([0.03, 0.5, 0.05]) / torch.tensor(ACTION_SCALE)
_LOSS_WEIGHT = torch.tensor([1.0, 0.2, 0.5])
_ESTIMATES_WEIGHT = 0.1
_RATE, _BATCH = 2e-3, 8  # initial learning rate; episodes of a step


class RecurrentActor(nn.Module):
    """Gated recurrent unit with a hidden layer; `estimates` supports learning only.

    Args:
        estimates: Number of the teacher's estimates that the hidden layer learns to predict.
        seed: Seed of the initial weights and of the order of the episodes.
    """

    def __init__(self, estimates: int, seed: int = 0):
        super().__init__()
        torch.manual_seed(seed)
        inputs = len(INPUT_SCALE)
        self.unit = nn.GRU(inputs, UNITS, batch_first=True)
        self.hidden = nn.Linear(UNITS + inputs, UNITS)
        self.action = nn.Linear(UNITS, 3)
        self.estimates = nn.Linear(UNITS, estimates)

    def forward(self, inputs):
        """Return scaled actions (b, t, 3) and estimates (b, t, k) for scaled inputs (b, t, 2 n)."""
        state, _ = self.unit(inputs)
        hidden = torch.tanh(self.hidden(torch.cat([state, inputs], dim=-1)))
        return self.action(hidden), self.estimates(hidden)

    def save(self, path: str | Path) -> None:
        """Write the actor for `controllers/policy.py`."""
        names = ("weight_ih_l0", "weight_hh_l0", "bias_ih_l0", "bias_hh_l0")
        arrays = [getattr(self.unit, name).detach().numpy() for name in names]
        unit = RecurrentUnit(**dict(zip(UNIT_ARRAYS, arrays, strict=True)))
        linear = (self.hidden, self.action)
        layers = [(x.weight.detach().numpy(), x.bias.detach().numpy()) for x in linear]
        scales = {"input_scale": INPUT_SCALE, "output_scale": ACTION_SCALE}
        save_policy(path, layers, activation="tanh", unit=unit, **scales)


def fit(actor: RecurrentActor, episodes: Sequence[tuple[Array, Array, Array]], epochs: int):
    """Fit an actor to episodes, with a learning rate that falls to a tenth.

    Args:
        actor: The actor, which is changed.
        episodes: As for `imitation_loss`.
        epochs: Number of passes over all episodes.

    Returns:
        The last loss.
    """
    learner = torch.optim.Adam(actor.parameters(), lr=_RATE)
    count = epochs * math.ceil(len(episodes) / _BATCH)
    schedule = torch.optim.lr_scheduler.LinearLR(learner, 1.0, 0.1, count)
    loss = torch.tensor(math.nan)
    for _ in range(epochs):
        for batch in torch.randperm(len(episodes)).split(_BATCH):
            learner.zero_grad()
            loss = imitation_loss(actor, [episodes[k] for k in batch.tolist()])
            loss.backward()
            nn.utils.clip_grad_norm_(actor.parameters(), 1.0)
            learner.step()
            schedule.step()
    return float(loss.detach())


def imitation_loss(actor: RecurrentActor, episodes: Sequence[tuple[Array, Array, Array]]):
    """Return the loss of an actor on whole episodes.

    Args:
        actor: The actor.
        episodes: Scaled inputs (t, 2 n), actions (t, 3) and the teacher's estimates (t, k) of each.

    Returns:
        The loss: mean squared difference of actions, on a scale that is logarithmic for large ones,
        and of the estimates.
    """
    inputs, actions, estimates = (
        nn.utils.rnn.pad_sequence([torch.as_tensor(part) for part in parts], batch_first=True)
        for parts in zip(*episodes, strict=True)
    )
    lengths = torch.tensor([len(part) for part, _, _ in episodes])
    valid = (torch.arange(inputs.shape[1]) < lengths[:, None]).float()
    weight = (valid / valid.sum())[..., None]
    found, found_estimates = actor(inputs)
    target = torch.asinh(actions / torch.tensor(ACTION_SCALE) / _LOSS_SCALE)
    error = (torch.asinh(found / _LOSS_SCALE) - target) ** 2 * _LOSS_WEIGHT
    error_estimates = (found_estimates - estimates) ** 2
    return (error * weight).sum() + _ESTIMATES_WEIGHT * (error_estimates * weight).sum()
