"""File of a policy: a network with its activation, checked when it is saved, loaded and evaluated.

A file.npz has the weights and biases w0, b0, w1, b1, … and the name of the activation between the
layers. With the arrays of a `RecurrentUnit`, the policy has a memory. A file.onnx is evaluated by
onnxruntime.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core import foreign_file
from mjtactile.core.errors import InputError
from mjtactile.core.policy import command_from_action, policy_observation
from mjtactile.core.policy_network import (
    ACTIVATIONS,
    DEFAULT_ACTIVATION,
    OUTPUTS,
    RECURRENT_SIZES,
    SIZES,
    Layers,
    check_finite,
    check_layers,
    checked_activation,
    sized,
)
from mjtactile.core.recurrent_policy import STATE, RecurrentUnit, read_unit, recurrent_observation
from mjtactile.core.signature_checks import validated
from mjtactile.core.types import Array, Command, Observation

_SUFFIXES = (".npz", ".onnx")
LARGEST = 1 << 26
"""Maximum size of a policy, also once it is unpacked, bytes."""
_ENTRIES = 200  # maximum number of arrays
_BROKEN = (
    *(OSError, ValueError, EOFError, KeyError, MemoryError, OverflowError, SyntaxError),
    *(NotImplementedError, RuntimeError, struct.error, zlib.error, zipfile.BadZipFile),
)
"""Errors of numpy and zipfile for damaged archives."""


@dataclass(frozen=True, eq=False)
class Policy:
    """Function from an observation vector to an action, with checks of both.

    Attributes:
        act: The function.
        inputs: Length of its vector.
        source: Its file, for messages.
        layers: Weights (outputs, inputs) and biases (outputs,), first to last; none of FILE.onnx.
        unit: Its memory; None: the action depends on the present observation only.
    """

    act: Callable[[Array], Array]
    inputs: int
    source: str
    layers: Layers = ()
    unit: RecurrentUnit | None = None

    def command(self, observation: Observation) -> Command:
        """Compute the command of a controller, with the policy's state in its memory.

        Args:
            observation: Observation of the controller.

        Returns:
            The command.

        Raises:
            InputError: The rig has another number of fingers than in training, or the action is not
                finite.
        """
        if self.unit is None:
            return command_from_action(observation, self(policy_observation(observation)))
        vector = recurrent_observation(observation)
        if len(vector) != self.unit.inputs:
            raise self._size_error(len(vector), self.unit.inputs, RECURRENT_SIZES)
        before: Any = observation.command.memory.get(STATE)
        features, kept = self.unit.after(vector, before)
        command = command_from_action(observation, self(features))
        return replace(command, memory={**command.memory, STATE: kept})

    def __call__(self, observation: ArrayLike) -> Array:
        """Evaluate the policy.

        Args:
            observation: Vector of `policy_observation`; with a `unit`, the features that it
                computes.

        Returns:
            Action (3,).

        Raises:
            InputError: The vector has another length than in training, or the action is not finite.
        """
        x = np.asarray(observation)
        if x.shape != (self.inputs,):
            raise self._size_error(x.size, self.inputs, {} if self.unit else SIZES)
        action = np.asarray(self.act(x))
        if action.shape != (OUTPUTS,):
            raise self._error("action", f"shape {action.shape} does not match ({OUTPUTS},)")
        if not np.isfinite(action).all():
            raise self._error("action", f"{action.tolist()} is not finite")
        return action

    def _size_error(self, found: int, trained: int, sizes: Mapping[int, int]) -> InputError:
        valid = f"but the policy was trained with {sized(trained, sizes)}"
        return self._error("observation", f"has {sized(found, sizes)}, {valid}")

    def _error(self, field: str, text: str) -> InputError:
        return InputError(text, source=self.source, field=field)


@validated()
def save_policy(
    path: str | Path,
    layers: Sequence[tuple[Any, Any]],
    *,
    activation: str | None = None,
    unit: RecurrentUnit | None = None,
    input_center: ArrayLike = 0.0,
    input_scale: ArrayLike = 1.0,
    output_center: ArrayLike = 0.0,
    output_scale: ArrayLike = 1.0,
) -> None:
    """Write a network for `controllers/policy.py`.

    The network computes a scaled action from a scaled observation. The input of the first layer is
    (observation - input_center) / input_scale. The action is output_center + output_scale times the
    output of the last layer. Both scales become part of the weights.

    Args:
        path: File, .npz.
        layers: Weights (outputs, inputs) and biases (outputs,) of each layer, first to last.
        activation: Function between the layers: "tanh" or "relu". A single layer needs none.
        unit: Memory ahead of the first layer, which then has its state, the scaled vector and the
            scaled change as inputs. Center and scale have one entry for each of the last two.
        input_center: Center of the observations, a number or one per entry.
        input_scale: Their scale. An entry with the scale inf is not used.
        output_center: Center of the actions.
        output_scale: Their scale.

    Raises:
        InputError: Shapes do not match, a value is not finite, or the activation is unknown.
    """
    source = "save_policy"
    target = Path(path)
    if target.suffix != ".npz":
        raise InputError(f"{target.name!r}", source=source, field="path", choices=["FILE.npz"])
    plain = [(np.asarray(w, float), np.asarray(b, float)) for w, b in layers]
    given = {} if unit is None else vars(unit)
    checked = read_unit(dict(given), tuple(RECURRENT_SIZES), source)
    check_layers(plain, source, checked)
    chosen = checked_activation(activation, len(plain), source)
    w, b = plain[0]
    first = 0 if checked is None else checked.units  # the state has no scale
    scale = np.ones(w.shape[1])
    center = np.zeros(w.shape[1])
    scale[first:] = _entries(input_scale, w.shape[1] - first, "input_scale", is_scale=True)
    center[first:] = _entries(input_center, w.shape[1] - first, "input_center")
    w = w / scale
    plain[0] = (w, b - w @ center)
    w, b = plain[-1]
    factor = _entries(output_scale, OUTPUTS, "output_scale")
    biases = _entries(output_center, OUTPUTS, "output_center") + factor * b
    plain[-1] = (w * factor[:, None], biases)
    check_finite(plain, source)
    arrays = {
        f"{kind}{k}": a
        for k, layer in enumerate(plain)
        for kind, a in zip("wb", layer, strict=True)
    }
    if checked is not None:
        arrays |= vars(checked.scaled(center[first:], scale[first:]))
    np.savez(target, allow_pickle=False, activation=np.array(chosen), **arrays)


def _entries(values: ArrayLike, count: int, field: str, *, is_scale: bool = False) -> Array:
    """Return (count,) values of a number or an array. Raises InputError."""
    found = np.asarray(values, float)
    if found.shape not in ((), (count,)):
        valid = ["a number", f"({count},)"]
        message = f"the shape {found.shape} does not match"
        raise InputError(message, source="save_policy", field=field, choices=valid)
    if np.isnan(found).any() or (is_scale and (found == 0).any()):
        raise InputError("a value is 0 or not a number", source="save_policy", field=field)
    return np.broadcast_to(found, count)


@validated()
def load_policy(path: str | Path) -> Policy:
    """Read the file of a policy.

    Args:
        path: FILE.npz of `save_policy`, or FILE.onnx with one input (1, n) and one output (1, 3).

    Returns:
        The policy, a function from `policy_observation` to the action of `command_from_action`.

    Raises:
        InputError: The file is missing or broken, shapes do not match, or a value is not finite.
    """
    source = Path(path)
    if source.suffix not in _SUFFIXES:
        choices = [f"FILE{suffix}" for suffix in _SUFFIXES]
        raise InputError("is no policy", source=source, choices=choices)
    if not foreign_file.is_file(source):
        raise InputError("no such file", source=source)
    return _load_onnx(source) if source.suffix == ".onnx" else _load_npz(source)


def _load_npz(path: Path) -> Policy:
    data = io.BytesIO(foreign_file.read_bytes(path, LARGEST, "a policy"))
    try:
        with zipfile.ZipFile(data) as archive:
            _require_bounded(archive, path)
        data.seek(0)
        with np.load(data, allow_pickle=False) as file:
            values = {name: file[name] for name in file.files}
    except _BROKEN as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"is no numpy archive: {text}", source=path) from error
    activation = str(values.pop("activation", DEFAULT_ACTIVATION))
    if any(np.asarray(value).dtype.kind not in "fiu" for value in values.values()):
        raise InputError("has arrays that are not numeric", source=path)
    unit = read_unit(values, tuple(RECURRENT_SIZES), path)
    count = len(values) // 2
    names = [f"{kind}{k}" for k in range(count) for kind in "wb"]
    if not names or set(names) != values.keys():
        found = ", ".join(sorted(values)) or "no arrays"
        raise InputError(f"has {found}", source=path, choices=["w0, b0, w1, b1, …"])
    layers = [(values[f"w{k}"], values[f"b{k}"]) for k in range(count)]
    check_layers(layers, path, unit)
    check_finite(layers, path)
    between = ACTIVATIONS[checked_activation(activation, count, path)]

    def act(x: Array) -> Array:
        for k, (w, b) in enumerate(layers):
            x = w @ (between(x) if k else x) + b
        return x

    return Policy(act, layers[0][0].shape[1], str(path), layers, unit)


def _require_bounded(archive: zipfile.ZipFile, path: Path) -> None:
    """Raise InputError for an archive that is much larger once it is unpacked."""
    entries = archive.infolist()
    size = sum(entry.file_size for entry in entries)
    if size > LARGEST or len(entries) > _ENTRIES:
        message = f"has {len(entries)} arrays of {size >> 20} MiB"
        choices = [f"at most {_ENTRIES} arrays of {LARGEST >> 20} MiB"]
        raise InputError(message, source=path, choices=choices)


def _load_onnx(path: Path) -> Policy:
    try:
        import onnxruntime  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise InputError("needs onnxruntime: pip install onnxruntime", source=path) from error
    data = foreign_file.read_bytes(path, LARGEST, "a policy")
    try:
        session = onnxruntime.InferenceSession(data)
    except Exception as error:  # onnxruntime has an error class for each of its codes
        text = " ".join(str(error).split())
        raise InputError(f"cannot be read: {text}", source=path) from error
    given, made = session.get_inputs(), session.get_outputs()
    shapes = f"inputs {[list(x.shape) for x in given]}, outputs {[list(x.shape) for x in made]}"
    if len(given) != 1 or len(made) != 1 or given[0].shape[-1] not in SIZES:
        choices = ["one input (1, 30) for two fingers, one output (1, 3)"]
        raise InputError(shapes, source=path, field="shape", choices=choices)
    name = given[0].name

    def act(x: Array) -> Array:
        return np.asarray(session.run(None, {name: x[None]})[0])[0]

    return Policy(act, given[0].shape[-1], str(path))
