"""Tests of the contact that a grasp reports: from which images, and with which values."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mjtactile.core.types import SHAPES, Contact, ContactShape, Touch
from mjtactile.runtime.held_contact import HeldContacts
from mjtactile.sensing.settings import DEFAULTS
from mjtactile.sensing.stateful_pipeline import StatefulPipeline


class Fitted(StatefulPipeline):
    """Pipeline that records its calls and returns one shape."""

    def __init__(self):
        self.asked = []
        self.pipeline: Any = SimpleNamespace(settings=DEFAULTS)

    def shape(self, touches):
        self.asked.append([touch.force_normal for touch in touches])
        fractions = dict.fromkeys(SHAPES, 0.0) | {"flat": 0.8, "edge": 0.2}
        return ContactShape("flat", fractions, area=4e-5, area_interval=(3e-5, 6e-5))


def cycle(phase, *forces, shape=None):
    touches = tuple(Touch(0.0, 0.0, force, 0.01, force > 0.02, shape=shape) for force in forces)
    return SimpleNamespace(touch=touches, sent=SimpleNamespace(phase=phase))


def test_the_load_and_the_last_image_of_the_hold_count():
    contacts = HeldContacts()
    for phase, force in (
        ("close", 0.0),
        ("close", 0.06),
        ("close", 0.07),  # less than twice the last kept one
        ("regulate", 0.13),
        ("hold", 0.4),
        ("hold", 0.5),
        ("release", 0.2),
    ):
        contacts.add(cycle(phase, force, 0.0))
    fingers = [Fitted(), Fitted()]
    found, other = contacts.estimate(fingers)
    assert fingers[0].asked == [[0.06, 0.13, 0.5]]
    assert fingers[1].asked == [] and other is None  # it never touched
    assert found["kind"] == "flat" and found["probability"] == 0.8
    assert found["area_mm2"] == pytest.approx(40)
    np.testing.assert_allclose(found["area_interval_mm2"], [30, 60])


def test_a_history_that_does_not_explain_the_hold_is_discarded():
    class Misled(StatefulPipeline):
        def __init__(self):
            self.pipeline: Any = SimpleNamespace(settings=DEFAULTS)

        def shape(self, touches):
            kind, misfit = ("flat", 3.3) if len(touches) > 1 else ("smooth", 0.9)
            return ContactShape(kind, dict.fromkeys(SHAPES, 0.0) | {kind: 1.0}, misfit=misfit)

    contacts = HeldContacts()
    contacts.add(cycle("close", 0.1))
    contacts.add(cycle("hold", 0.6))
    (found,) = contacts.estimate([Misled()])
    assert found["kind"] == "smooth" and found["misfit"] == 0.9


def test_the_area_of_a_shape_that_explains_little_is_that_of_the_traction():
    shape = ContactShape("flat", dict.fromkeys(SHAPES, 0.2), area=4e-5, misfit=3.3)
    mask = np.ones((2, 2), dtype=bool)
    patch = Contact(True, 9e-5, np.zeros(2), 1e-3, mask, area_interval=np.array([4e-5, 1.6e-4]))
    (touch,) = cycle("hold", 0.6, shape=shape).touch
    contacts = HeldContacts()
    contacts.add(
        SimpleNamespace(touch=(replace(touch, contact=patch),), sent=SimpleNamespace(phase="hold"))
    )
    (found,) = contacts.estimate([Fitted()])
    assert found["kind"] == "flat" and found["area_mm2"] == pytest.approx(90)
    np.testing.assert_allclose(found["area_interval_mm2"], [40, 160])


def test_a_run_with_shapes_has_its_own():
    shape = ContactShape("unknown", dict.fromkeys(SHAPES, np.nan))
    contacts = HeldContacts()
    contacts.add(cycle("hold", 0.4, shape=shape))
    finger = Fitted()
    (found,) = contacts.estimate([finger])
    assert not finger.asked and found["kind"] == "unknown" and np.isnan(found["area_mm2"])


def test_synthetic_touch_has_no_contact_shape():
    contacts = HeldContacts()
    contacts.add(cycle("hold", 0.4))
    assert contacts.estimate([object()]) == (None,)
