"""File of a policy: a network with its activation, checked when it is saved, loaded and evaluated.

A file.npz has the weights and biases w0, b0, w1, b1, … and the name of the activation between the
layers. A file.onnx is evaluated by onnxruntime.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core import foreign_file
from mjtactile.core.errors import InputError
from mjtactile.core.policy import policy_observation_names
from mjtactile.core.signature_checks import validated
from mjtactile.core.types import Array

ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, 0.0),
}
"""Activations between the layers, by name."""
OUTPUTS = 3
"""Length of an action."""
_BEFORE = "tanh"  # activation of files that name none
_FINGERS_MAX = 8
_SIZES = {len(policy_observation_names(n)): n for n in range(1, _FINGERS_MAX + 1)}
_SUFFIXES = (".npz", ".onnx")
LARGEST = 1 << 26
"""Maximum size of a policy, also once it is unpacked, bytes."""
_ENTRIES = 200  # maximum number of arrays
_BROKEN = (
    *(OSError, ValueError, EOFError, KeyError, MemoryError, OverflowError, SyntaxError),
    *(NotImplementedError, RuntimeError, struct.error, zlib.error, zipfile.BadZipFile),
)
"""Errors of numpy and zipfile for damaged archives."""
_Layers = Sequence[tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class Policy:
    """Function from an observation vector to an action, with checks of both.

    Attributes:
        act: The function.
        inputs: Length of its vector.
        source: Its file, for messages.
        layers: Weights (outputs, inputs) and biases (outputs,), first to last; none of FILE.onnx.
    """

    act: Callable[[Array], Array]
    inputs: int
    source: str
    layers: _Layers = ()

    def __call__(self, observation: ArrayLike) -> Array:
        """Evaluate the policy.

        Args:
            observation: Vector of `policy_observation`.

        Returns:
            Action (3,).

        Raises:
            InputError: The vector has another length than in training, or the action is not finite.
        """
        x = np.asarray(observation)
        if x.shape != (self.inputs,):
            trained = f"the policy was trained with {_sized(self.inputs)}"
            raise self._error("observation", f"has {_sized(x.size)}, but {trained}")
        action = np.asarray(self.act(x))
        if action.shape != (OUTPUTS,):
            raise self._error("action", f"shape {action.shape} does not match ({OUTPUTS},)")
        if not np.isfinite(action).all():
            raise self._error("action", f"{action.tolist()} is not finite")
        return action

    def _error(self, field: str, text: str) -> InputError:
        return InputError(text, source=self.source, field=field)


@validated()
def save_policy(
    path: str | Path,
    layers: Sequence[tuple[Any, Any]],
    *,
    activation: str | None = None,
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
    _check_layers(plain, source)
    chosen = _checked_activation(activation, len(plain), source)
    w, b = plain[0]
    w = w / _entries(input_scale, w.shape[1], "input_scale", is_scale=True)
    plain[0] = (w, b - w @ _entries(input_center, w.shape[1], "input_center"))
    w, b = plain[-1]
    scale = _entries(output_scale, OUTPUTS, "output_scale")
    plain[-1] = (w * scale[:, None], _entries(output_center, OUTPUTS, "output_center") + scale * b)
    _check_finite(plain, source)
    arrays = {
        f"{kind}{k}": a
        for k, layer in enumerate(plain)
        for kind, a in zip("wb", layer, strict=True)
    }
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
    activation = str(values.pop("activation", _BEFORE))
    count = len(values) // 2
    names = [f"{kind}{k}" for k in range(count) for kind in "wb"]
    if not names or set(names) != values.keys():
        found = ", ".join(sorted(values)) or "no arrays"
        raise InputError(f"has {found}", source=path, choices=["w0, b0, w1, b1, …"])
    if any(value.dtype.kind not in "fiu" for value in values.values()):
        raise InputError("has arrays that are not numeric", source=path)
    layers = [(values[f"w{k}"], values[f"b{k}"]) for k in range(count)]
    _check_layers(layers, path)
    _check_finite(layers, path)
    between = ACTIVATIONS[_checked_activation(activation, count, path)]

    def act(x: Array) -> Array:
        for k, (w, b) in enumerate(layers):
            x = w @ (between(x) if k else x) + b
        return x

    return Policy(act, layers[0][0].shape[1], str(path), layers)


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
    if len(given) != 1 or len(made) != 1 or given[0].shape[-1] not in _SIZES:
        choices = ["one input (1, 30) for two fingers, one output (1, 3)"]
        raise InputError(shapes, source=path, field="shape", choices=choices)
    name = given[0].name

    def act(x: Array) -> Array:
        return np.asarray(session.run(None, {name: x[None]})[0])[0]

    return Policy(act, given[0].shape[-1], str(path))


def _check_layers(layers: _Layers, source: Any) -> None:
    """Check that each layer fits the one before, the observation, and the action."""
    if not layers:
        raise InputError("has no layers", source=source, field="layers")
    first = layers[0][0].shape
    inputs = first[1] if len(first) == 2 else 0
    if inputs not in _SIZES:
        is_turned = len(first) == 2 and first[0] in _SIZES
        text = f"weights {first} have {inputs} inputs{_transposed_hint(is_turned)}"
        choices = [f"{size} for {n} finger{'s' if n > 1 else ''}" for size, n in _SIZES.items()]
        raise InputError(text, source=source, field="layers[0]", choices=choices[:3])
    for k, (w, b) in enumerate(layers):
        outputs = OUTPUTS if k == len(layers) - 1 else b.size
        if w.shape != (outputs, inputs) or b.shape != (outputs,):
            hint = _transposed_hint(w.shape == (inputs, outputs))
            text = f"weights {w.shape} and biases {b.shape} do not match{hint}"
            choices = [f"weights ({outputs}, {inputs}) and biases ({outputs},)"]
            raise InputError(text, source=source, field=f"layers[{k}]", choices=choices)
        inputs = outputs


def _transposed_hint(is_turned: bool) -> str:
    return "; the weights are transposed" if is_turned else ""


def _check_finite(layers: _Layers, source: Any) -> None:
    for k, layer in enumerate(layers):
        for name, values in zip(("weights", "biases"), layer, strict=True):
            count = int(np.size(values) - np.isfinite(values).sum())
            if count:
                text = f"{count} of {np.size(values)} {name} are not finite"
                raise InputError(text, source=source, field=f"layers[{k}]")


def _checked_activation(name: str | None, layers: int, source: Any) -> str:
    """Return the name of the activation; a single layer needs none."""
    if name is None and layers == 1:
        return _BEFORE
    if name not in ACTIVATIONS:
        text = "is not given" if name is None else f"{name!r} is unknown"
        raise InputError(text, source=source, field="activation", choices=list(ACTIVATIONS))
    return name


def _sized(count: int) -> str:
    fingers = _SIZES.get(count)
    of = f" (of {fingers} finger{'s' if fingers > 1 else ''})" if fingers else ""
    return f"{count} values{of}"
