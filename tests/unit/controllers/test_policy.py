"""Tests of policy files as controllers: the network of a numpy archive against an explicit
evaluation, and against ONNX if onnxruntime is installed."""

import importlib.util

import numpy as np
import pytest

from mjtactile import ControllerError
from mjtactile.core import resources
from mjtactile.core.policy import command_from_action, policy_observation
from mjtactile.runtime.controller import load_controller
from tests.unit.core.test_policy import seen


def controller(monkeypatch, path):
    monkeypatch.setenv("MJTACTILE_POLICY", str(path))
    return load_controller("policy")


def test_the_adapter_is_short():
    assert len(resources.find("policy", "controllers", ".py").read_text().splitlines()) <= 40


def test_a_network_of_two_layers(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    w0, b0, w1, b1 = (rng.standard_normal(shape) for shape in ((5, 30), 5, (3, 5), 3))
    np.savez(tmp_path / "p.npz", w0=w0, b0=b0, w1=w1, b1=b1)
    observation = seen((0.3, 0.4))
    action = w1 @ np.tanh(w0 @ policy_observation(observation) + b0) + b1
    assert controller(monkeypatch, tmp_path / "p.npz").step(observation) == command_from_action(
        observation, action
    )


def test_a_broken_file_is_refused_when_the_controller_is_loaded(tmp_path, monkeypatch):
    """It is refused before the rig is opened, not at the first step."""
    with pytest.raises(ControllerError, match=r"none.npz: no such file"):
        controller(monkeypatch, tmp_path / "none.npz")


@pytest.mark.skipif(
    importlib.util.find_spec("onnxruntime") is None or importlib.util.find_spec("onnx") is None,
    reason="needs onnx and onnxruntime",
)
def test_the_network_equals_onnx(tmp_path, monkeypatch):
    from onnx import TensorProto, helper, save

    w = np.random.default_rng(1).standard_normal((30, 3)).astype(np.float32)
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["x", "w"], ["y"])],
        "policy",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 30])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, [1, 3])],
        [helper.make_tensor("w", TensorProto.FLOAT, w.shape, w.ravel())],
    )
    save(
        helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9),
        str(tmp_path / "p.onnx"),
    )
    observation = seen((0.3, 0.4))
    command = controller(monkeypatch, tmp_path / "p.onnx").step(observation)
    assert command.opening == pytest.approx(
        command_from_action(observation, policy_observation(observation) @ w).opening, abs=1e-9
    )
