"""Tests of the start of shape fits by a network (docs/theory/contact_shape.md, Eq. F27)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mjtactile import load_sensor
from mjtactile.core import resources
from mjtactile.sensing.contact_shape import amortized_start as starts
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.network import Network, train
from mjtactile.sensing.contact_shape.random_presses import GROUPS, random_presses
from mjtactile.sensing.contact_shape.shape_models import FAMILIES
from mjtactile.sensing.contact_shape.start_files import (
    _loaded,
    fingerprint,
    keep_start,
    load_start,
    make_start,
    reference_guess,
)
from mjtactile.sensing.settings import DEFAULTS

SETTINGS = DEFAULTS.contact_shape
NOISE = 25e-6  # of a marker's height in one image and of the membrane model, m
THETAS = {
    "smooth": [1.0, -2.0, 0.3, 120.0, 30.0, 60.0],
    "ball": [1.0, -2.0, 0.3, 90.0],
    "cylinder": [1.0, -2.0, 0.3, 90.0, 0.7, 0.03],
    "disc": [1.0, -2.0, 0.3, 0.05, -0.02, 4.5],
    "block": [1.0, -2.0, 0.3, 0.05, -0.02, 0.4, 4.5, 3.0],
}


@pytest.fixture(scope="module")
def start():
    found = load_start(load_sensor("dense"), 1000.0, SETTINGS)
    assert found is not None  # it is shipped
    return found


@pytest.fixture(scope="module")
def presses():
    """Return presses outside the training data."""
    forward = ForwardModel(load_sensor("dense"), None, SETTINGS.spacing, 1010.0)
    rng = np.random.default_rng(7001)
    return random_presses(forward, reference_guess(forward), 256, rng, SETTINGS)


def proposed(start, presses):
    rng = np.random.default_rng(3)
    ids = np.arange(presses.heights.shape[1])
    noisy = presses.heights + NOISE * rng.standard_normal(presses.heights.shape)
    return [start.propose(heights, ids) for heights in noisy]


@pytest.mark.parametrize("name", THETAS)
def test_parameters_survive_the_coding(name):
    theta = np.array(THETAS[name])
    center = np.array([1.6, -1.1])
    point, numbers = (np.array(part) for part in starts._ENCODED[name](center, theta))
    decoded = starts._DECODED[name](center, point, numbers)
    if name == "cylinder":  # the place along the axis is free: that next to the pressure center
        axis = np.array([np.cos(theta[4]), np.sin(theta[4]), -np.tan(theta[5])])
        along = float((decoded[:2] - theta[:2]) @ axis[:2])
        np.testing.assert_allclose(decoded[:3], theta[:3] + along * axis, atol=1e-9)
        decoded, theta = decoded[3:], theta[3:]
    np.testing.assert_allclose(decoded, theta, atol=1e-9)


def test_the_shipped_network_is_accurate_on_other_presses(start, presses):
    """Firm presses: two of five models contain the right one in 82 % of its own test."""
    firm = np.flatnonzero((presses.force > 0.2) & (presses.group < len(FAMILIES)))
    found = proposed(start, presses)
    ranks = [np.argsort(-found[n].probabilities[: len(FAMILIES)]) for n in firm]
    right = [presses.group[n] in rank[:2] for n, rank in zip(firm, ranks, strict=True)]
    assert len(firm) > 40 and np.mean(right) > 0.75
    off = [np.abs(np.log(found[n].area / presses.area[n])) for n in firm]
    assert np.median(off) < 0.3
    centers = [found[n].outputs[starts._CENTER] - presses.center[n] for n in firm]
    assert np.median(np.linalg.norm(centers, axis=1)) < 0.4  # mm; markers are 3 to 4 mm apart


def test_missing_markers_are_completed(start, presses):
    ids = np.delete(np.arange(presses.heights.shape[1]), [5, 40, 41])
    off = [start.view.completed(h[ids], ids) - h for h in presses.heights]
    assert np.median(np.abs(off)[:, [5, 40, 41]]) < 5e-5


def test_a_network_belongs_to_one_sensor_and_pressure():
    design = load_sensor("dense")
    thicker = replace(design, membrane=replace(design.membrane, thickness=0.35e-3))
    assert fingerprint(design, SETTINGS) != fingerprint(thicker, SETTINGS)
    assert load_start(thicker, 1000.0, SETTINGS) is None
    assert load_start(design, 1400.0, SETTINGS) is None


@pytest.mark.parametrize("sensor", ["dense", "dense_fiducials", "fine", "paper16"])
def test_shipped_sensors_have_a_network(sensor):
    design = load_sensor(sensor)
    path = resources.folder("models/contact_shapes") / f"{fingerprint(design, SETTINGS)}.npz"
    assert path.is_file()


def test_a_network_is_read_back_from_its_file(tmp_path):
    """Also of a sensor with 16 markers and one with an outline; few presses, and no accuracy."""
    for sensor in ("paper16", "round30"):
        design = load_sensor(sensor)
        start = make_start(design, SETTINGS, presses=48, rounds=2)
        path = keep_start(tmp_path, "one", start)
        with np.load(path) as file:
            from mjtactile.sensing.contact_shape.start_files import _unpacked

            again = _unpacked(design, dict(file))
        ids = np.arange(len(design.markers.p_SM))
        heights = -1e-3 * np.exp(-(((design.markers.p_SM[:, :2]) / 5e-3) ** 2).sum(axis=1))
        a, b = start.propose(heights, ids), again.propose(heights, ids)
        np.testing.assert_allclose(a.probabilities, b.probabilities, rtol=1e-4)
        assert a.probabilities.sum() == pytest.approx(1) and len(a.probabilities) == len(GROUPS)
        assert np.isfinite(a.theta("block")).all()


def test_a_network_fits_a_function():
    """Adam on 400 samples of a smooth function; a linear fit leaves 0.3 of its spread."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (400, 2)).astype(np.float32)
    y = (np.sin(3 * x[:, :1]) * x[:, 1:]).astype(np.float32)
    network = Network.initial((2, 32, 32, 1), rng)
    rounds = train(network, lambda _: x, lambda out, at: (out - y[at]) / len(at), 500, rng)
    for trained in rounds:
        network = trained
    assert np.std(network(x) - y) < 0.1 * np.std(y)
    assert network(x[0]).shape == (1,)


def test_the_cached_network_is_used(tmp_path, monkeypatch):
    design = load_sensor("dense")
    thicker = replace(design, membrane=replace(design.membrane, thickness=0.36e-3))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = tmp_path / "mjtactile" / "contact_shapes"
    start = make_start(thicker, SETTINGS, presses=48, rounds=1)
    keep_start(folder, fingerprint(thicker, SETTINGS), start)
    _loaded.cache_clear()
    assert load_start(thicker, 1000.0, SETTINGS) is not None
