"""Tests of `advance` against `mj_step`: bit-identical with the same tolerance in both solves,
within the tolerance without the first solve."""

import mujoco
import numpy as np
import pytest

from mjtactile.sim.attach import attach_membrane, configure_options
from mjtactile.sim.fast_step import advance

SCENE = """<mujoco><worldbody>
 <body name="hand" pos="0 0 0.1"><joint type="slide" axis="0 0 1" range="0 1" limited="true"/><geom size="0.01" mass="0.2"/>
  <site name="tip" pos="0 0 0.03"/></body>
 <body name="ball" pos="0.003 0 0.1412"><freejoint/><geom size="0.008" mass="0.02"/></body>{more}
</worldbody><sensor><accelerometer site="tip"/><force site="tip"/></sensor></mujoco>"""
FLYING = (
    '<body pos="0.3 0 0.3"><freejoint/><geom type="box" size="0.01 0.02 0.03" mass="0.1"/></body>'
)
STATE = mujoco.mjtState.mjSTATE_INTEGRATION
BLOW = 0.2  # upward, m/s
STEPS = 40  # of 4 ms: the ball falls on, bounces and rolls


def scene(more=""):
    """Return a scene of a ball that falls onto a sensor, whose arm rests at its joint limit."""
    spec = mujoco.MjSpec.from_string(SCENE.format(more=more))
    configure_options(spec)
    attachment = attach_membrane(spec, "dense", site="tip", mesh=(9, 7))
    model = spec.compile()
    data = mujoco.MjData(model)
    sensor = attachment.bind(model, data)
    sensor.open_valve()
    return model, data, sensor


def state(model, data):
    values = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, values, STATE)
    return values


def pairs(model, data, sensor, **how):
    """Yield states after each step of `advance`, and of `mj_step` from the same state.

    Halfway an impulse acts on the arm. The last step's acceleration is then a bad start for the
    solver, and the result depends on the first solve.
    """
    twin = mujoco.MjData(model)
    for count in range(STEPS):
        if count == STEPS // 2:
            data.qvel[0] += BLOW
        sensor.update()
        mujoco.mj_copyData(twin, model, data)
        mujoco.mj_step(model, twin)
        advance(model, data, **how)
        yield data, twin


def test_with_the_same_tolerance_step_is_bit_identical_to_mj_step():
    model, data, sensor = scene()
    for computed, reference in pairs(model, data, sensor, first_tolerance=model.opt.tolerance):
        np.testing.assert_array_equal(state(model, computed), state(model, reference))
        np.testing.assert_array_equal(computed.sensordata, reference.sensordata)
    assert data.ncon > 0


@pytest.mark.parametrize(("tolerance", "left"), [(1e-7, 2e-4), (1e-10, 1e-5)])
def test_without_the_first_solve_step_equals_mj_step_within_the_tolerance(tolerance, left):
    """The step equals mj_step within the tolerance.

    Two solutions with different starts differ by the tolerance's effect. The limit in m/s is four
    times the maximum measured; the impulse changes the arm's velocity by 0.2 m/s.
    """
    model, data, sensor = scene()
    model.opt.tolerance = tolerance
    largest = max(
        np.abs(computed.qvel - reference.qvel).max()
        for computed, reference in pairs(model, data, sensor)
    )
    assert 0 < largest < left
    assert data.nidof == model.nv


def test_a_free_body_is_not_in_the_second_solve():
    """A box in free fall is in no second solve: it falls by g, and the membrane next to it equals
    that of mj_step."""
    model, data, sensor = scene(FLYING)
    start = data.qvel[-6:].copy()
    for computed, reference in pairs(model, data, sensor):
        np.testing.assert_array_equal(state(model, computed), state(model, reference))
    np.testing.assert_allclose(
        data.qvel[-6:] - start, [0, 0, -9.81 * data.time, 0, 0, 0], atol=1e-6
    )


@pytest.mark.parametrize(
    "option",
    [
        'integrator="implicitfast"',
        'integrator="discrete" noslip_iterations="3"',
        'integrator="discrete" solver="PGS"',
    ],
)
def test_under_other_options_step_is_mj_step(option):
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><option {option}/><worldbody><geom type="plane" size="1 1 .1"/>
        <body pos="0 0 0.1"><freejoint/><geom type="box" size=".05 .03 .02"/></body></worldbody></mujoco>""")
    computed = mujoco.MjData(model)
    reference = mujoco.MjData(model)
    for _ in range(100):
        advance(model, computed)
        mujoco.mj_step(model, reference)
    np.testing.assert_array_equal(state(model, computed), state(model, reference))
