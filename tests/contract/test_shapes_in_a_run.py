"""A controller that reads shapes has them in a run, the same bits beside the world or in a process,
and nobody else has them."""

from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core.errors import ControllerError
from mjtactile.core.scenario import Scenario
from mjtactile.recording.reader import load_recording
from mjtactile.recording.writer import Recorder
from mjtactile.run.controller import load_controller
from mjtactile.run.grasp import run_grasp

CLOSES = """
from dataclasses import replace

READS = ("shape",)


def step(observation):
    command = observation.command
    felt = [touch.force_normal for touch in observation.touch]
    held = command.memory.get("held", 0.0) + (min(felt) > 0.15)
    seen = [touch.shape.kind for touch in observation.touch]
    opening = command.opening - (0.02 if max(felt) < 0.2 else 0.003) * observation.period
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


def test_a_controller_says_what_it_reads(tmp_path, controller):
    assert controller.reads == ("shape",)
    path = tmp_path / "wrong.py"
    path.write_text(CLOSES.replace('("shape",)', '("colour",)'))
    with pytest.raises(ControllerError, match=r"wrong\.py: READS: 'colour' .* choices: shape"):
        load_controller(path)


@pytest.mark.slow
def test_shapes_are_the_same_bits_in_a_process(tmp_path, controller):
    columns = []
    for workers, asks in ((0, True), (1, True), (0, False)):
        folder = tmp_path / f"run{len(columns)}"
        asking = controller if asks else replace(controller, function=_without, reads=())
        with Recorder(folder, {"object": "egg"}) as recorder:
            run_grasp(Scenario(seed=5), [recorder], workers=workers, controller=asking)
        columns.append(load_recording(folder).columns)
    with_shapes, in_a_process, without = columns
    kinds = {kind for row in with_shapes["shape_kind"] for kind in row}
    assert kinds - {"unknown"}, kinds
    for key in ("shape_area", "shape_radius", "force_normal", "contact_area"):
        np.testing.assert_array_equal(with_shapes[key], in_a_process[key])
    assert {kind for row in without["shape_kind"] for kind in row} == {"none"}
    assert np.isnan(without["shape_area"]).all()


def _without(observation):
    """The same controller, which looks at no shape."""
    felt = [touch.force_normal for touch in observation.touch]
    command = observation.command
    held = command.memory.get("held", 0.0) + (min(felt) > 0.15)
    assert all(touch.shape is None for touch in observation.touch)
    opening = command.opening - (0.02 if max(felt) < 0.2 else 0.003) * observation.period
    phase = "done" if held > 5 else "close"
    return replace(command, opening=opening, force_limit=4.0, memory={"held": held}, phase=phase)
