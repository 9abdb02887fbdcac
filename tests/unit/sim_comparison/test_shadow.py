"""Tests of a recording against its simulation: real differences are named, and none if there is
none."""

import json
from dataclasses import replace

import numpy as np
import pytest

from mjtactile.cli import main
from mjtactile.core.config_fields import ML_S_KPA
from mjtactile.core.design import load_sensor
from mjtactile.core.scenario import Scenario
from mjtactile.experiments.motion_stage import record_stage
from mjtactile.recording.stage_protocol import Move, Stage
from mjtactile.recording.writer import Recorder
from mjtactile.rig.as_built_sensor import AsBuiltSensor, true_design
from mjtactile.rig.domain_randomization import SampledWorld
from mjtactile.rig.file import load_sim_rig
from mjtactile.runtime.controller import load_controller
from mjtactile.runtime.session import Session
from mjtactile.sim.rig import build_sim_rig
from mjtactile.sim_comparison.attribution import explain
from mjtactile.sim_comparison.compare import shadow_of
from mjtactile.sim_comparison.discrepancy_parameters import causes_of
from mjtactile.sim_comparison.html_report import page, verdict
from mjtactile.sim_comparison.resimulate import _as_built_sensor
from mjtactile.sim_comparison.signals import Signals

SEED = 201  # of the camera: none that the tolerances were chosen with
UNTIL = 0.8  # duration in s of a grasp: 50 Pa are lost by then
PRESS = Stage("sphere:8", (0.0, 0.0), (Move(0.2, 1.5e-3, speed=0.01), Move(1.0)))


# -- a rig that is a formula
# --------------------------------------------------------------------------------

TIME = np.arange(120) / 30.0
COMMANDS = ("leak", "stiffness", "gauge", "opening", "along")


def formula(amounts, *, noise=0.0, seed=0):
    """Return the response of two fingers: stiffness scales the force and moves markers, a leak
    reduces pressures, the jaws' opening reduces force."""

    def of(name):
        return np.broadcast_to(amounts.get(name, (0.0, 0.0)), (2,))

    rng = np.random.default_rng(seed)
    press = np.clip(TIME - 1.0, 0.0, 1.0)
    force = np.zeros((len(TIME), 2, 3))
    grip = np.maximum(0.6 - 400.0 * of("opening")[0], 0.0) * (1 + 0.5 * of("stiffness"))
    force[..., 2] = -press[:, None] * grip
    force[..., 0] = press[:, None] * 30.0 * of("along")[0]
    bulge = np.linspace(2e-3, 4e-3, 12)
    markers = np.zeros((len(TIME), 2, 12, 3))
    markers[..., 2] = bulge * (1 - 0.3 * of("stiffness"))[:, None] + 1e-3 * force[..., 2:]
    pressure = 1000.0 + of("gauge") - 4e9 * of("leak") * TIME[:, None]
    return Signals(
        TIME,
        force + rng.normal(0, 0.01 * noise, force.shape),
        markers + rng.normal(0, 1e-5 * noise, markers.shape),
        pressure + rng.normal(0, 5.0 * noise, pressure.shape),
    )


def named(shadow):
    assert shadow.named is not None, verdict(shadow)
    return shadow.named


def explained(**amounts):
    recorded = formula(amounts, noise=1.0, seed=SEED)
    return explain(recorded, formula, causes_of(False, COMMANDS))


def test_without_a_difference_no_cause_is_reported():
    shadow = explained()
    assert not shadow.differs and shadow.named is None and not shadow.tried
    assert verdict(shadow).startswith("agrees with the simulator")


def test_a_leak_is_reported_for_its_finger():
    shadow = explained(leak=(2e-8, 0.0))
    assert named(shadow).cause.name == "leak" and shadow.explains > 0.95
    left, right = named(shadow).amounts
    # 120 readings of 5 Pa over 320 Pa: 1 %
    assert left == pytest.approx(2e-8, rel=0.02) and abs(right) < 4e-10
    assert "left: gas leaks" in page(shadow, ("left", "right"), "a run")


def test_a_jaw_offset_is_separated_from_the_cause():
    """A jaw offset of 0.2 mm reduces the force by 0.08 N, in addition to softer rubber."""
    shadow = explained(stiffness=(-0.3, -0.3), opening=(2e-4, 2e-4))
    assert named(shadow).cause.name == "stiffness"
    # the spread of the jaws and the noise leave some: half of their effect alone (0.27)
    assert named(shadow).amounts[0] == pytest.approx(-0.3, abs=0.05)
    assert shadow.allowed["opening"] == pytest.approx(2e-4, rel=0.4)


def test_a_change_without_a_known_cause_is_not_attributed():
    """An oscillating pressure is not among the causes."""
    recorded = formula({}, noise=1.0, seed=SEED)
    swing = 200.0 * np.sin(9 * TIME)[:, None]
    odd = replace(recorded, pressure=recorded.pressure + swing)
    shadow = explain(odd, formula, causes_of(False, COMMANDS))
    assert shadow.differs and shadow.named is None
    assert "no single cause explains it" in verdict(shadow)


# -- the simulator
# --------------------------------------------------------------------------------


def staged(folder, as_built, seconds=1.6):
    """Record `as_built` under the sensor name "dense"."""
    with Recorder(folder / "recording", {"object": None, "sensor": "dense", "seed": SEED}) as own:
        record_stage(as_built, PRESS, own, seconds=seconds, seed=SEED)
        own.close(outcome="recorded")
    return folder


def test_a_sensor_equal_to_its_file_agrees_with_the_simulation(tmp_path, capsys):
    folder = staged(tmp_path / "run", load_sensor("dense"))
    assert main(["compare-sim", str(folder), "--out", str(tmp_path / "out"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert not result["differs"] and result["named"] is None
    assert (tmp_path / "out/shadow.html").read_text().count("<svg") == 3
    assert json.loads((tmp_path / "out/shadow.json").read_text()) == result


@pytest.mark.slow(10)
def test_softer_rubber_is_named(tmp_path):
    dense = load_sensor("dense")
    soft = replace(dense, membrane=replace(dense.membrane, young=0.75 * dense.membrane.young))
    causes = ("leak", "stiffness", "pre_stretch", "gauge")
    shadow, _ = shadow_of(staged(tmp_path, soft, seconds=0.8), causes=causes)
    names = {named(shadow).cause.name, *(item.cause.name for item in shadow.alike)}
    # at one pressure pre-stretch explains it as well (docs/how-to/identify.md), and this is
    # reported
    assert names == {"stiffness", "pre_stretch"}
    found = {item.cause.name: item.amounts[0] for item in (named(shadow), *shadow.alike)}
    assert found["stiffness"] == pytest.approx(-0.25, abs=0.05)
    assert shadow.explains > 0.9


def test_creep_is_applied_to_the_simulated_membrane():
    """The simulated membrane gets the creep of the as-built sensor.

    An indentation of 1.6 s on a membrane that relaxes by 10 % per decade was identified as 10.1 %;
    stiffness and pre-stretch were nearly as good. In a shorter time, creep is the same as
    stiffness.
    """
    design = true_design(load_sensor("dense"), _as_built_sensor({"creep": (0.0, 0.1)}, 1))
    assert design.relaxation is not None
    fractions = [fraction for fraction, _ in design.relaxation.terms]
    assert fractions == [0.1] * len(fractions)
    assert (
        true_design(load_sensor("dense"), _as_built_sensor({"creep": (0.0, 0.1)}, 0)).relaxation
        is None
    )


@pytest.mark.slow(10)
def test_a_leak_is_named(tmp_path):
    dense = load_sensor("dense")
    gas = replace(dense.chamber, leak_conductance=0.05 * ML_S_KPA)
    causes = ("leak", "gauge", "stiffness", "creep")
    recorded = staged(tmp_path, replace(dense, chamber=gas), seconds=1.0)
    shadow, _ = shadow_of(recorded, causes=causes)
    assert named(shadow).cause.name == "leak" and not shadow.alike
    assert named(shadow).amounts[0] == pytest.approx(0.05 * ML_S_KPA, rel=0.15)


class FirstSeconds:
    """Shipped controller for the compared part of the recording."""

    def __init__(self, seconds):
        self.controller = load_controller("gentle")
        self.path = self.controller.path
        self.seconds = seconds
        self.end = None

    def step(self, observation):
        self.end = self.end or observation.time + self.seconds
        command = self.controller.step(observation)
        return replace(command, phase="done") if observation.time > self.end else command


@pytest.mark.slow(8)
def test_a_leaking_left_chamber_of_a_gripper_is_named(tmp_path):
    """The first commands of a grasp are repeated on a simulated gripper without the leak."""
    scenario = Scenario(seed=SEED, sensor="paper16", effects="-mesh,-images")
    as_built = (AsBuiltSensor("left", leak=0.06 * ML_S_KPA),)
    rig = build_sim_rig(scenario, file=load_sim_rig("sim"), sampled=SampledWorld(as_built=as_built))
    try:
        session = Session(rig, threads=0)
        with Recorder(tmp_path / "recording", scenario.header(), frames=0) as recorder:
            session.take_references(recorder)
            session.run(FirstSeconds(UNTIL + 0.1), time_limit=60.0, observer=recorder)
            recorder.close(outcome="recorded")
    finally:
        rig.close()
    shadow, _ = shadow_of(tmp_path, until=UNTIL, causes=("leak", "stiffness"))
    assert named(shadow).cause.name == "leak"
    left, right = named(shadow).amounts
    # 50 Pa in 0.8 s are read to 5 Pa each, 24 times
    assert left == pytest.approx(0.06 * ML_S_KPA, rel=0.3) and right < 0.3 * left


def test_a_recording_that_states_no_object_is_refused(tmp_path, capsys):
    from tests.fake_run import fake_cycle

    with Recorder(tmp_path / "run", {"sensor": "dense"}, frames=0) as recorder:
        recorder.add(fake_cycle(0))
    assert main(["compare-sim", str(tmp_path / "run")]) == 2
    assert "--object" in capsys.readouterr().err
