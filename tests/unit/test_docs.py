"""What the documents show works: the README's scene, the object and the controller to copy, the links."""

import re
from pathlib import Path

import numpy as np
import pytest

from mjtactile.controller import load_controller
from mjtactile.sim.objects import load_object
from mjtactile.types import Command, GripperState, Observation, Touch, ValveState

CHECKOUT = Path(__file__).resolve().parents[2]
PAGES = [CHECKOUT / "README.md", CHECKOUT / "CHANGELOG.md", *sorted((CHECKOUT / "docs").rglob("*.md"))]


def block(page: str, language: str) -> str:
    return re.search(rf"```{language}\n(.*?)```", (CHECKOUT / page).read_text(), re.DOTALL).group(1)


def test_attach_example_of_the_readme():
    names: dict = {}
    exec(block("README.md", "python"), names)
    assert names["p_SM"].shape == (81, 3) and np.isfinite(names["p_SM"]).all()
    assert names["p_SM"][:, 2].max() > 1e-3  # it is inflated


def test_object_example(tmp_path):
    (tmp_path / "plum.xml").write_text(block("docs/objects.md", "xml"))
    plum = load_object(tmp_path / "plum.xml")
    assert plum.break_force == 2.0 and plum.material == "soft" and plum.grasp_height == 0.02


def test_controller_example(tmp_path):
    (tmp_path / "mine.py").write_text(block("docs/controllers.md", "python"))
    controller = load_controller(tmp_path / "mine.py")

    def observe(force):
        touch = Touch(1.0, 0.0, force, 0.01, force > 0.05)
        state, valves = GripperState(0.05, 0, 0, 0), (ValveState(False), ValveState(False))
        return Observation(1.0, 1 / 30, (touch, touch), state, valves, Command(0.05, 3.0))

    assert controller.step(observe(0.0)).opening == pytest.approx(0.05 - 0.01 / 30)
    assert controller.step(observe(0.4)).phase == "done"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text()):
        assert (page.parent / target).exists(), target
