"""Tests of a grasp while the cameras shift, zoom and change their image settings: the egg is held
as without these faults."""

from dataclasses import replace

import pytest

from mjtactile.core.design import load_sensor
from mjtactile.core.scenario import Scenario
from mjtactile.recording.observer import Observer
from mjtactile.runtime.grasp import run_grasp
from tests.emulated_host import controller_text

FAULTS = """[camera]
from_s = 3.2
image_shift_px = [2, 2]
rotation_deg = 0.3
scale_percent = 0.4
gamma = 1.2
jpeg_quality = 80
"""


class ErrorObserver(Observer):
    """Observer of the normal-force error of both fingers in standard deviations, and of their
    statuses."""

    def __init__(self):
        self.off = []
        self.statuses = set()

    def add(self, cycle, view=None, **truth):
        for touch, true in zip(cycle.touch, truth["force_normal_true"], strict=True):
            self.off.append((touch.force_normal - true) / touch.force_normal_sd)
            self.statuses.add(str(touch.status))


@pytest.mark.slow(9)
@pytest.mark.parametrize(("sensor", "rate"), [("dense", 30.0), ("dense_fiducials", 15.0)])
def test_a_grasp_continues_after_both_cameras_are_shifted(tmp_path, sensor, rate):
    """A camera shift just after first contact (3.2 s) does not end the grasp.

    The force error always stays within five reported standard deviations. With fiducials, half
    of the images suffice.
    """
    design = load_sensor(sensor)
    design = replace(design, camera=replace(design.camera, rate=rate))
    path = tmp_path / "knocked.toml"
    path.write_text(FAULTS)
    quick = tmp_path / "quick.py"
    quick.write_text(controller_text(hold=0.2))
    scenario = Scenario(
        object="egg",
        sensor=design,
        effects="-mesh",
        controller=str(quick),
        seed=6,
        randomization=str(path),
    )
    errors = ErrorObserver()
    result = run_grasp(scenario, [errors])
    assert result.outcome == "held" and errors.statuses == {"ok"}
    assert max(abs(off) for off in errors.off) < 5
    # force in N; the error of a grasp without faults is 0.008
    assert result.hold_force == pytest.approx(result.hold_force_true, abs=0.03)
