"""Tests of contact shapes in a run: forces come from them in a scenario or for a controller that
requests it.

The bits are the same next to the world and in another process. Other runs have shapes that change
no force.
"""

from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core.errors import ControllerError
from mjtactile.core.scenario import Scenario
from mjtactile.recording.reader import load_recording
from mjtactile.recording.writer import Recorder
from mjtactile.report.shape_wireframe import lines_of, recorded_shape
from mjtactile.rig.scenario import resolve_scenario
from mjtactile.runtime.controller import load_controller
from mjtactile.runtime.grasp import run_grasp
from tests.emulated_host import controller_text

CLOSES = """
from dataclasses import replace

REQUIRES = ("contact_shape",)


def step(observation):
    command = observation.command
    felt = [touch.force_normal for touch in observation.touch]
    held = command.memory.get("held", 0.0) + (min(felt) > 0.15)
    seen = [touch.shape.kind for touch in observation.touch]
    opening = command.opening - (0.04 if max(felt) < 0.1 else 0.005) * observation.period
    return replace(
        command, opening=opening, force_limit=4.0, memory={"held": held},
        phase="done" if held > 5 else "close", reason=" ".join(seen),
    )
"""


@pytest.fixture
def controller(tmp_path):
    path = tmp_path / "closes.py"
    path.write_text(CLOSES)
    return load_controller(path)


def test_a_controller_declares_its_inputs(tmp_path, controller):
    assert controller.reads == ("contact_shape",)
    path = tmp_path / "wrong.py"
    path.write_text(CLOSES.replace('("contact_shape",)', '("colour",)'))
    with pytest.raises(
        ControllerError, match=r"wrong\.py: REQUIRES: 'colour' .* choices: contact_shape"
    ):
        load_controller(path)


@pytest.mark.slow
def test_shapes_from_another_process_are_bit_identical(tmp_path, controller):
    recordings = []
    asked = replace(controller, reads=())
    unasked = replace(controller, function=_without, reads=())
    for workers, asks, shapes in ((0, controller, False), (1, asked, True), (0, unasked, False)):
        folder = tmp_path / f"run{len(recordings)}"
        with Recorder(folder, {"object": "egg"}) as recorder:
            scenario = Scenario(seed=5, effects="-mesh,-images", contact_shapes=shapes)
            run_grasp(scenario, [recorder], workers=workers, controller=asks)
        recordings.append(load_recording(folder))
    # a replay finds them again where they were asked for
    replayed = [resolve_scenario(Scenario(rig=f"replay:{one.folder}")) for one in recordings]
    assert [one.contact_shapes for one in replayed] == [True, True, False]
    with_shapes, in_a_process, without = (one.columns for one in recordings)
    kinds = {kind for row in with_shapes["shape_kind"] for kind in row}
    assert kinds - {"unknown"}, kinds
    for key in ("shape_area", "shape_place", "shape_sliding", "force_normal", "contact_area"):
        np.testing.assert_array_equal(with_shapes[key], in_a_process[key])
    known = np.argwhere(np.isfinite(with_shapes["shape_radius"]))
    cycle, finger = known[-1]
    # positions are right even in a sealed chamber that contact has compressed: an egg of 32 mm on a
    # mesh of 13 x 11. A ball sinks by 0.2 mm between its vertices on each side
    both = recordings[0].column("shape_place")[cycle, :, 2]
    assert recordings[0].column("opening")[cycle, 0] - both.sum() == pytest.approx(0.032, abs=7e-4)
    kept = recorded_shape(recordings[0], cycle, finger)
    assert kept is not None
    assert kept.radius == with_shapes["shape_radius"][cycle, finger] and len(kept.outline) > 8
    assert len(lines_of(kept)) == 3  # a border and two arcs, as pictures of a recording draw them
    assert [one.has_shape_forces for one in recordings] == [True, True, False]
    assert {kind for row in without["shape_kind"] for kind in row} >= kinds
    areas = without["shape_area"]
    estimated = np.isfinite(areas)
    assert estimated.any()
    np.testing.assert_array_equal(areas[estimated], without["contact_area"][estimated])


def _without(observation):
    """The same controller, which requests no shape."""
    estimated = [touch.force_normal for touch in observation.touch]
    command = observation.command
    held = command.memory.get("held", 0.0) + (min(estimated) > 0.15)
    assert all(touch.shape is None or touch.shape.motion is None for touch in observation.touch)
    opening = command.opening - (0.04 if max(estimated) < 0.1 else 0.005) * observation.period
    phase = "done" if held > 5 else "close"
    return replace(command, opening=opening, force_limit=4.0, memory={"held": held}, phase=phase)


@pytest.mark.slow(25)
def test_an_egg_is_smooth_on_the_default_mesh(tmp_path):
    """Vertices 3 mm apart: light contacts look flat, and curvatures change with depth. Curvatures
    of the egg are 1/16 and 16/20^2 per mm."""
    (tmp_path / "quick.py").write_text(controller_text(hold=0.3))
    scenario = Scenario(seed=1, effects="-images", controller=str(tmp_path / "quick.py"))
    result = run_grasp(scenario, [], workers=0)
    assert result.outcome == "held"
    for contact in result.contacts:
        assert contact is not None
        assert contact["kind"] == "smooth" and contact["status"] == "ok"
        # a load of 0.6 N on 1 kPa; as a face of the same markers, half of it
        assert 100 < contact["area_mm2"] < 150
        low, high = contact["area_interval_mm2"]
        assert low < contact["area_mm2"] < high
