"""Tests of policy files: what a policy computes, and one line for each defect of a network."""

import struct
import zipfile

import numpy as np
import pytest

from mjtactile.core.errors import InputError
from mjtactile.core.policy_file import load_policy, save_policy

INPUTS = 30  # of two fingers
RNG = np.random.default_rng(0)
W0 = RNG.normal(size=(8, INPUTS))
W1 = RNG.normal(size=(3, 8))
LAYERS = [(W0, np.ones(8)), (W1, np.zeros(3))]
ONE = [(np.zeros((3, INPUTS)), np.zeros(3))]


@pytest.mark.parametrize(
    ("name", "between"), [("tanh", np.tanh), ("relu", lambda x: np.maximum(x, 0))]
)
def test_a_policy_is_the_network_behind_the_scales(tmp_path, name, between):
    """Explicit scaling equals that of the file; both are sums of the same products."""
    path = tmp_path / "policy.npz"
    center = RNG.normal(size=INPUTS)
    scale = np.where(np.arange(INPUTS) == 4, np.inf, 2.0)  # one entry is not used
    save_policy(
        path,
        LAYERS,
        activation=name,
        input_center=center,
        input_scale=scale,
        output_center=[0.1, 0.2, 0.3],
        output_scale=0.5,
    )
    policy = load_policy(path)
    x = RNG.normal(size=INPUTS)
    inner = between(W0 @ ((x - center) / scale) + 1)
    np.testing.assert_allclose(policy(x), [0.1, 0.2, 0.3] + 0.5 * (W1 @ inner), rtol=1e-12)
    unused = x + 7 * (np.arange(INPUTS) == 4)
    np.testing.assert_array_equal(policy(unused), policy(x))


def test_an_old_file_without_an_activation_is_tanh(tmp_path):
    path = tmp_path / "policy.npz"
    np.savez(path, w0=W0, b0=np.ones(8), w1=W1, b1=np.zeros(3))
    x = RNG.normal(size=INPUTS)
    np.testing.assert_allclose(load_policy(path)(x), W1 @ np.tanh(W0 @ x + 1), rtol=1e-12)


@pytest.mark.parametrize(
    ("layers", "activation", "text"),
    [
        ([], "tanh", "layers: has no layers"),
        (LAYERS, None, "activation: is not given .valid: tanh, relu"),
        (LAYERS, "gelu", "activation: 'gelu' is unknown .valid: tanh, relu"),
        ([(W0.T, np.ones(8)), LAYERS[1]], "tanh", r"layers\[0\]: weights \(30, 8\).*transposed"),
        ([LAYERS[0], (W1.T, np.zeros(3))], "tanh", r"layers\[1\]: weights \(8, 3\).*transposed"),
        ([LAYERS[0], (W1[:2], np.zeros(2))], "tanh", r"weights \(2, 8\).*valid: weights \(3, 8\)"),
        ([(W0[:, :16], np.ones(8)), LAYERS[1]], "tanh", "16 inputs .valid: 22 for 1 finger"),
        ([(W0 * np.nan, np.ones(8)), LAYERS[1]], "tanh", "240 of 240 weights are not finite"),
        ([(W0, np.full(8, np.inf)), LAYERS[1]], "tanh", "8 of 8 biases are not finite"),
    ],
)
def test_a_wrong_network_is_one_line_when_saved(tmp_path, layers, activation, text):
    with pytest.raises(InputError, match=text) as caught:
        save_policy(tmp_path / "policy.npz", layers, activation=activation)
    assert "\n" not in str(caught.value) and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("scales", "text"),
    [
        ({"input_scale": np.ones(5)}, r"input_scale: the shape \(5,\).*valid: a number, \(30,\)"),
        ({"input_center": np.ones((30, 1))}, r"input_center: the shape \(30, 1\)"),
        ({"input_scale": 0.0}, "input_scale: a value is 0"),
        ({"output_scale": [1, np.nan, 1]}, "output_scale: a value is 0 or not a number"),
    ],
)
def test_wrong_scales_are_one_line_when_saved(tmp_path, scales, text):
    with pytest.raises(InputError, match=text):
        save_policy(tmp_path / "policy.npz", ONE, **scales)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arrays", "text"),
    [
        ({"w0": W0}, "valid: w0, b0, w1, b1"),
        ({"w0": W0[:3] * np.nan, "b0": np.zeros(3)}, "90 of 90 weights are not finite"),
        ({"w0": W0[:3].T, "b0": np.zeros(3)}, "transposed"),
        ({"w0": W0[:3].astype(str), "b0": np.zeros(3)}, "not numeric"),
        (dict(w0=W0, b0=np.ones(8), w1=W1, b1=np.zeros(3), activation="gelu"), "gelu"),
    ],
)
def test_a_wrong_file_is_one_line_when_loaded(tmp_path, arrays, text):
    path = tmp_path / "policy.npz"
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=text) as caught:
        load_policy(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_a_file_of_another_kind_is_named(tmp_path):
    broken = tmp_path / "broken.npz"
    broken.write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(InputError, match="is no numpy archive"):
        load_policy(broken)
    with pytest.raises(InputError, match="no such file"):
        load_policy(tmp_path / "none.npz")
    with pytest.raises(InputError, match=r"valid: FILE\.npz, FILE\.onnx"):
        load_policy(tmp_path / "policy.pt")
    with pytest.raises(InputError, match=r"valid: FILE\.npz"):
        save_policy(tmp_path / "policy.pt", ONE)


def test_another_rig_and_an_overflow_are_named_at_the_step(tmp_path):
    path = tmp_path / "policy.npz"
    save_policy(path, ONE)
    policy = load_policy(path)
    text = r"has 38 values \(of 3 fingers\), but the policy was trained with 30 values \(of 2 fing"
    with pytest.raises(InputError, match=text):
        policy(np.zeros(38))
    save_policy(path, [(np.full((3, INPUTS), 1e308), np.zeros(3))])
    with pytest.raises(InputError, match=r"action: .* is not finite"), np.errstate(all="ignore"):
        load_policy(path)(np.ones(INPUTS))


def npy(shape, data=b"", dtype="<f8"):
    """Return an array of numpy whose header states any shape."""
    text = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    text += b" " * (63 - (10 + len(text)) % 64) + b"\n"
    return b"\x93NUMPY\x01\0" + struct.pack("<H", len(text)) + text + data


BOMBS = {
    "zeros that unpack to 200 MB": lambda: {"w0.npy": npy((25_000_000,), b"\0" * 200_000_000)},
    "a shape of 8 TB": lambda: {"w0.npy": npy((10**12,))},
    "a shape that overflows": lambda: {"w0.npy": npy((2**62, 2**62))},
    "a negative shape": lambda: {"w0.npy": npy((-1,))},
    "objects": lambda: {"w0.npy": npy((1,), b"\0" * 8, "|O")},
    "no header": lambda: {"w0.npy": b"\x93NUMPY\x01\0\xff\xff"},
    "a header that is code": lambda: {"w0.npy": npy("__import__('os')")},
    "nested header": lambda: {"w0.npy": npy("(" * 9000 + ")" * 9000)},
    "thousands of arrays": lambda: {f"w{k}.npy": npy((1,), b"\0" * 8) for k in range(5000)},
    "no array": lambda: {"w0.npy": b"text"},
}


@pytest.mark.parametrize("kind", BOMBS)
def test_an_archive_that_would_unpack_without_bounds_is_refused(tmp_path, kind):
    """Sizes are checked before unpacking, and each defect is reported in one line."""
    path = tmp_path / "policy.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in BOMBS[kind]().items():
            archive.writestr(name, data)
    with pytest.raises(InputError, match=r"policy\.npz: ") as caught:
        load_policy(path)
    assert "\n" not in str(caught.value)
