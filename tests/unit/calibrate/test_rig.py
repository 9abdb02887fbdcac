"""Tests of `calibrate gripper` and `calibrate valve`: fits against synthetic ground truth, and the
guided runs over real ptys.

The jaws here have mechanics of this test (backlash, a spring block, a torque constant unlike the
data sheet's). The results can therefore be compared with the given values.
"""

import contextlib
import io
import json
import math
import threading
from dataclasses import replace

import numpy as np
import pytest

from mjtactile.calibrate import interactive
from mjtactile.calibrate.gripper import calibrate_force, calibrate_opening, servo_lines
from mjtactile.calibrate.valve import calibrate_valve
from mjtactile.cli import main
from mjtactile.commands.calibrate.terminal import ask
from mjtactile.core import scaled_clock
from mjtactile.core.calibration import load_calibration
from mjtactile.core.errors import DeviceError, InputError
from mjtactile.devices.dynamixel.jaw_kinematics import JawGeometry
from mjtactile.devices.valve.driver import connect_valves
from mjtactile.rig.file import load_rig_file
from tests.emulated import ANGLE, GRIPPER, servo_bench, valve_bench, valve_configs

RADIUS = 0.012
TICK = 2 * math.pi / 4096


def write_csv(path, header, rows):
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


# -- gripper: the fits
# --------------------------------------------------------------------------------


def readings(offset=4e-4, scale=1.01, backlash=3e-4, noise=1e-5):
    rng = np.random.default_rng(0)
    reported = np.repeat([0.03, 0.05, 0.08, 0.1], 2)
    direction = ["closing", "opening"] * 4
    sign = np.where(np.array(direction) == "opening", 1.0, -1.0)
    return (
        reported,
        direction,
        offset + scale * reported - backlash / 2 * sign + rng.normal(0, noise, 8),
    )


def test_offset_scale_and_backlash_are_recovered():
    fit = calibrate_opening(*readings())
    for name, true in (("offset", 4e-4), ("scale", 1.01), ("backlash", 3e-4)):
        # of their own standard deviations
        assert abs(getattr(fit, name) - true) < 4 * getattr(fit, f"{name}_sd"), name
    assert not fit.reasons


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"scale": 1.05}, "mm_per_rad"),
        ({"backlash": 2e-3}, "loose horn"),
        ({"noise": 1e-3}, "deviate from the fit"),
        ({"backlash": -3e-4}, "directions may be swapped"),
    ],
)
def test_a_bad_opening_is_refused_with_its_reason(changes, word):
    assert any(word in reason for reason in calibrate_opening(*readings(**changes)).reasons)


def test_lines_for_the_rig_file_reproduce_the_caliper_values():
    """With the new lines a servo position corresponds to the opening measured by the caliper,
    without backlash."""
    reported, direction, measured = readings(noise=0.0)
    fit = calibrate_opening(reported, direction, measured)
    geometry = JawGeometry(GRIPPER, "test")
    lines = servo_lines(geometry, fit, None)
    servos = tuple(
        replace(s, zero_ticks=line["zero_ticks"], per_rad=1e-3 * line["mm_per_rad"])
        for s, line in zip(GRIPPER.servos, lines, strict=True)
    )
    better = JawGeometry(replace(GRIPPER, servos=servos), "test")
    for opening in (0.03, 0.1):
        ticks = geometry.goals(opening)
        # a tick for each servo
        assert better.opening(ticks) == pytest.approx(4e-4 + 1.01 * opening, abs=2 * RADIUS * TICK)


def test_force_factor_and_friction_are_recovered():
    reported = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    fit = calibrate_force(reported, 0.8 * reported - 0.15)
    assert (fit.factor, fit.offset) == (
        pytest.approx(0.8),
        pytest.approx(-0.15),
    ) and not fit.reasons
    assert "servo model" in calibrate_force(reported, 0.3 * reported).reasons[0]
    assert any("its zero" in reason for reason in calibrate_force(reported, reported + 1.0).reasons)


def test_recorded_readings_through_the_command(tmp_path, capsys):
    reported, direction, measured = readings()
    openings = write_csv(
        tmp_path / "caliper.csv",
        "reported_mm,direction,measured_mm",
        zip(1e3 * reported, direction, 1e3 * measured, strict=True),
    )
    forces = write_csv(
        tmp_path / "cell.csv", "measured_N,reported_N", [(0.8 * f, f) for f in (1, 2, 3, 4)]
    )
    arguments = [
        "calibrate",
        "gripper",
        "--rig",
        "two_xm430",
        "--out",
        str(tmp_path / "g.json"),
        "--json",
    ]
    assert main([*arguments, "--openings", str(openings), "--forces", str(forces)]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["opening"]["backlash_mm"] == pytest.approx(0.3, abs=0.05)
    assert result["servo"][0]["torque_Nm_per_A"] == pytest.approx(
        1.78 * 0.8 * result["opening"]["scale"], rel=1e-3
    )
    assert json.loads((tmp_path / "g.json").read_text())["verdict"] == "good"
    forces.write_text("reported_N,measured_N\n1,x\n2,2\n3,3\n4,4\n")
    assert main([*arguments, "--forces", str(forces)]) == 2
    assert "line 2, column measured_N" in json.loads(capsys.readouterr().out)["error"]


# -- gripper: on a pty
# --------------------------------------------------------------------------------


class Mechanism:
    """Jaws on two pinions with backlash between servo and jaw, and an elastic block between the
    jaws, moved by a thread."""

    def __init__(self, servos, *, play=0.0, block=0.0, stiffness=4e3, torque_fraction=1.0):
        self.servos = servos
        self.play = play
        self.block = block
        self.stiffness = stiffness
        self.fraction = torque_fraction
        self.motor = self.jaw = RADIUS * ANGLE  # position of each jaw, m
        self.force = 0.0
        self._stop = scaled_clock.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()

    @property
    def opening(self):
        return 2 * self.jaw

    def _run(self):
        while not self._stop.wait(0.002):
            drives = [servo.drive() for servo in self.servos.values()]
            if any(drive.torque_max == 0 for drive in drives):
                continue
            before = self.motor
            # maximum force on each finger, N
            maximum = self.fraction * sum(drive.torque_max for drive in drives) / 2 / RADIUS
            goal = RADIUS * drives[0].goal
            self.motor += float(np.clip(goal - self.motor, -4e-4, 4e-4))  # at 0.2 m/s
            # the block holds it up
            self.motor = max(self.motor, self.block / 2 - maximum / self.stiffness - self.play / 2)
            self.jaw = float(
                np.clip(self.jaw, self.motor - self.play / 2, self.motor + self.play / 2)
            )
            self.force = max(0.0, (self.block / 2 - self.jaw) * self.stiffness)
            for servo in self.servos.values():
                servo.follow_load(
                    self.motor / RADIUS,
                    (self.motor - before) / 0.002 / RADIUS,
                    -self.force * RADIUS / self.fraction,
                    0.002,
                )


@pytest.fixture
def short_waits(monkeypatch):
    """Shorten the waiting times of the guided run: the mechanism here settles at once."""
    for name, value in (
        ("_SPEED", 0.1),
        ("_REST_TIME", 0.1),
        ("_STALL_TIME", 0.12),
        ("_VALVE_STAGES", (0.35, 0.7, 0.3)),
    ):
        monkeypatch.setattr(interactive, name, value)


@pytest.mark.clock(7)
def test_backlash_and_zero_of_jaws_on_a_bus(short_waits):
    with (
        servo_bench() as bench,
        Mechanism(bench.servos, play=2e-4) as jaws,
        contextlib.closing(bench.gripper()) as gripper,
    ):
        fit = calibrate_opening(
            *interactive.measure_openings(
                gripper, [0.055, 0.08], lambda _: 1e3 * (jaws.opening + 5e-4), 2.0, lambda _: None
            )
        )
    # Two jaws with 0.2 mm each, a caliper that shows 0.5 mm more; a tick of each servo is 0.018 mm
    assert fit.backlash == pytest.approx(4e-4, abs=5e-5)
    # read off 55 and 80 mm: ticks weigh 80 / 25 times at 0
    assert fit.offset == pytest.approx(5e-4, abs=2e-4)
    assert not fit.reasons


@pytest.mark.clock(7)
def test_current_to_force_of_jaws_on_a_bus(short_waits):
    with (
        servo_bench() as bench,
        Mechanism(bench.servos, block=0.06, torque_fraction=0.75) as jaws,
        contextlib.closing(bench.gripper()) as gripper,
    ):
        fit = calibrate_force(
            *interactive.measure_forces(
                gripper, [1.0, 2.0, 3.0, 4.0], lambda _: jaws.force, lambda _: None
            )
        )
    assert fit.factor == pytest.approx(0.75, abs=0.01)  # current in units of 1 mA of 30 mA and more
    assert not fit.reasons


@pytest.mark.clock
def test_jaws_without_contact_give_no_calibration(short_waits):
    with (
        servo_bench() as bench,
        Mechanism(bench.servos),
        contextlib.closing(bench.gripper()) as gripper,
        pytest.raises(DeviceError, match="closed without contact"),
    ):
        interactive.measure_forces(gripper, [1.0], lambda _: 0.0, lambda _: None)


# -- valve
# --------------------------------------------------------------------------------


def step(offset=10.0, tau=0.06, leak=0.5, reached=1000.0, noise=4.0):
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 16.0, 0.02)
    state = np.select([t < 1, t < 3, t < 13], ["vent", "open", "closed"], "vent")
    rise = reached * (1 - np.exp(-(t - 1) / tau))
    sealed = reached - leak * (t - 3)
    p = offset + np.select(
        [t < 1, t < 3, t < 13], [0.0, rise, sealed], (reached - 10 * leak) * np.exp(-(t - 13) / tau)
    )
    return t, p + rng.normal(0, noise, len(t)), list(state)


def test_parameters_of_a_step_response_are_recovered():
    fit = calibrate_valve(*step(), 1000.0)
    assert fit.offset == pytest.approx(10, abs=2)  # mean of 33 samples with 4 Pa
    assert fit.noise_sd == pytest.approx(4, rel=0.4)
    # first order; samples every 0.02 s
    assert fit.rise_time == pytest.approx(math.log(9) * 0.06, rel=0.1)
    assert fit.time_constant == pytest.approx(0.06, abs=0.02)  # a sample
    assert fit.leak == pytest.approx(0.5, abs=4 * fit.leak_sd) and fit.leak_sd < 0.1
    assert fit.fall_time == pytest.approx(math.log(9) * 0.06, rel=0.15)
    assert not fit.reasons


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"offset": 80.0}, "zero"),
        ({"leak": 5.0}, "loses"),
        ({"tau": 0.6}, "90 %"),
        ({"reached": 700.0}, "instead of 1000"),
        ({"noise": 80.0}, "noise"),
    ],
)
def test_a_bad_valve_is_refused_with_its_reason(changes, word):
    assert any(word in reason for reason in calibrate_valve(*step(**changes), 1000.0).reasons)


def test_recorded_step_through_the_command(tmp_path, capsys):
    t, p, state = step(leak=5.0)
    table = write_csv(
        tmp_path / "step.csv", "time_s,pressure_kPa,state", zip(t, 1e-3 * p, state, strict=True)
    )
    out = tmp_path / "valve.json"
    assert main(["calibrate", "valve", str(table), "--pressure-kPa", "1", "--out", str(out)]) == 1
    assert "REFUSED: the sealed chamber loses" in capsys.readouterr().out
    written = load_calibration(out)
    assert (
        written.valve is None and "the sealed chamber loses" in written.refused["valve"].reasons[0]
    )
    write_csv(table, "time_s,pressure_kPa,state", [(i, 0.0, "shut") for i in range(20)])
    assert main(["calibrate", "valve", str(table), "--pressure-kPa", "1", "--out", str(out)]) == 2
    assert "valid: vent, open, closed" in capsys.readouterr().err


@pytest.mark.clock(12)
def test_a_valve_on_a_pty(short_waits):
    with valve_bench() as (port, _, _, chambers):
        boards, valves = connect_valves(valve_configs(port.path))
        start = scaled_clock.monotonic()
        chambers.leak = 0.1  # leak, Pa every 5 ms
        try:
            fit = interactive.calibrate_live_valve(valves[0], 1000.0, 2.0, lambda _: None)
        finally:
            boards[0].close()
        passed = scaled_clock.monotonic() - start
    assert fit.offset == pytest.approx(0, abs=5)  # 5 Pa of noise, some 20 samples
    # The board's lag of 50 ms gives 0.11 s; its clock stops while a busy computer does not run it.
    assert 0.05 < fit.rise_time < 0.6
    assert 2 < fit.leak < 25, passed  # 20 Pa/s; a busy computer ticks less often
    assert any("loses" in reason for reason in fit.reasons)


@pytest.mark.clock
def test_a_board_without_a_sensor_cannot_be_calibrated(short_waits):
    with valve_bench(sensors=False) as (port, *_):
        boards, valves = connect_valves(valve_configs(port.path))
        try:
            with pytest.raises(InputError, match="no pressure sensor"):
                interactive.step_valve(valves[0], 1000.0, 1.0, lambda _: None)
        finally:
            boards[0].close()


def test_every_rig_file_names_servos_that_can_be_calibrated():
    for name in ("emulated", "two_xm430", "one_xl330_linkage"):
        rig_file = load_rig_file(name)
        geometry = JawGeometry(rig_file.gripper, name)
        lines = servo_lines(geometry, calibrate_opening(*readings(noise=0.0)), None)
        assert [line["id"] for line in lines] == [servo.id for servo in rig_file.gripper.servos]


# -- the person at the terminal
# --------------------------------------------------------------------------------


def test_readings_are_repeated_until_they_are_finite(monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO("twelve\n12,5\n\n"))
    assert ask("caliper, mm") == 12.5  # a comma is a decimal point to half of the world
    assert "'twelve' is not a number" in capsys.readouterr().err
    assert ask("caliper, mm") is None
    with pytest.raises(InputError, match="terminal input ended"):
        ask("caliper, mm")
