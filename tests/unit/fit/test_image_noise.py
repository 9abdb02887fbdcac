"""Tests of light, noise and blur estimated from images whose values differ from the sensor file."""

from dataclasses import replace

import pytest

from mjtactile.core.design import load_sensor
from mjtactile.fit.image_noise import fit_image_noise
from mjtactile.sim.rendering.renderer import Renderer

DENSE = load_sensor("dense")
TRUE = replace(
    DENSE,
    camera=replace(DENSE.camera, blur_px=0.9, noise_dn=2.6),
    leds=replace(DENSE.leds, membrane_dn=170.0, marker_dn=52.0, vignetting=0.31),
)


@pytest.fixture(scope="module")
def found():
    renderer = Renderer(TRUE, seed=3)
    n_S = 0 * DENSE.markers.p_SM + [0, 0, 1]
    return fit_image_noise(
        DENSE, [renderer.render(DENSE.markers.p_SM, n_S) for _ in range(6)]
    ).values


@pytest.mark.parametrize(
    ("field", "true", "fraction"),
    [
        ("camera.blur_px", 0.9, 0.02),  # the design accuracy of the edge estimator
        (
            "camera.noise_DN",
            2.6,
            0.01,
        ),  # a million differences; the rounding's part is exact to less
        ("leds.membrane_DN", 170.0, 0.005),
        ("leds.marker_DN", 52.0, 0.02),
        ("leds.vignetting", 0.31, 0.02),
    ],
)
def test_rendered_noise_is_identified(found, field, true, fraction):
    value, sd = found[field]
    assert value == pytest.approx(true, rel=fraction)
    assert abs(value - true) < 3 * sd
