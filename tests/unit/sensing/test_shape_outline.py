"""Tests of contact shapes on a sensor with a non-rectangular frame, with the camera's noise.

Obstacles indent a membrane on a grid that is not a multiple of the estimator's.
"""

import numpy as np
import pytest

from mjtactile import QuasistaticMembrane, SensingPipeline, load_sensor
from mjtactile.quasistatic.interpolation import interpolation_matrix
from mjtactile.types import Markers

NOISE = np.array([3.4e-6, 3.4e-6, 19e-6])  # marker noise of one `dense` image, m


class Round:
    """Pipeline and shape estimator of a sensor, and a quasi-static membrane to press, 0.5 mm nodes."""

    def __init__(self, name):
        design = load_sensor(name)
        self.flat = design.markers.p_SM
        self.pipeline = SensingPipeline(design)
        sides = (design.frame.length, design.frame.width)
        self.membrane = QuasistaticMembrane(
            design, tuple(2 * round(side / 1e-3) + 1 for side in sides)
        )
        self.carried = interpolation_matrix(self.membrane, self.flat[:, :2])
        rest = self.seen(self.membrane.rest.x)
        self.state = self.pipeline.load_rest_reference(
            self.pipeline.initial_state(), rest, self.membrane.gauge_pressure
        )
        self.finder = self.pipeline.make_shape_estimator(self.state)
        self.top = float(self.membrane.rest.heights.max())

    def seen(self, x, rng=None):
        places = self.flat + self.carried @ x.reshape(3, -1).T
        count = len(places)
        noise = 0.0 if rng is None else NOISE * rng.standard_normal((count, 3))
        up = np.tile([0.0, 0, 1], (count, 1))
        return Markers(
            np.arange(count), places + noise, up, np.tile(np.diag(NOISE**2), (count, 1, 1))
        )

    def shape(self, body, seed):
        state = self.membrane.solve(body)
        markers = self.seen(state.x, np.random.default_rng(seed))
        touch = self.pipeline.estimate_touch(
            self.state, markers, self.pipeline.fitter.fit(markers), 0.0
        )[0]
        return state, self.pipeline.estimate_contact_shape(self.state, [touch], self.finder)


@pytest.fixture(scope="module", params=["round30", "ellipse"])
def sensor(request):
    return Round(request.param)


@pytest.mark.parametrize(("radius", "at"), [(9e-3, (-2e-3, 3e-3)), (14e-3, (4e-3, -2e-3))])
def test_a_ball_is_a_ball_of_its_radius(sensor, radius, at):
    ball = sensor.membrane.obstacle("sphere", (radius,), (*at, sensor.top - 2e-3 + radius))
    state, shape = sensor.shape(ball, 7)
    assert shape.kind == "smooth"
    assert abs(shape.radius - radius) < 2.5 * shape.radius_sd
    assert shape.radius == pytest.approx(radius, rel=0.15)  # one image, as on `dense`
    # a sliding contact carries 2.4 % less than the estimate, which is fitted to sticking membranes
    assert shape.force_normal == pytest.approx(state.force_normal, rel=0.1)


def test_a_face_is_a_face_and_a_lying_rod_goes_on_to_the_rim(sensor):
    face = sensor.membrane.obstacle("cylinder", (4e-3, 6e-3), (2e-3, -1e-3, sensor.top + 4.5e-3))
    assert sensor.shape(face, 8)[1].kind == "flat"
    lying = [[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]  # along y
    at = (1e-3, 0, sensor.top + 8.2e-3)
    rod = sensor.membrane.obstacle("capsule", (10e-3, 12e-3), at, lying)
    found = sensor.shape(rod, 9)[1]
    assert found.kind == "smooth"
    across = max(found.curvatures)
    assert across == pytest.approx(100.0, rel=0.15)  # 1/m
