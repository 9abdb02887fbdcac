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


class FittedPipeline(StatefulPipeline):
    """Pipeline that records its calls and returns one shape."""

    def __init__(self, kind="smooth", misfit=0.9):
        self.asked = []
        self.found = of_kind(kind, misfit)
        self.pipeline: Any = SimpleNamespace(settings=DEFAULTS)

    def shape(self, touches):
        self.asked.append([touch.force_normal for touch in touches])
        return self.found


def of_kind(kind, misfit=1.0):
    fractions = dict.fromkeys(SHAPES, 0.0) | {kind: 0.8}
    return ContactShape(kind, fractions, area=4e-5, area_interval=(3e-5, 6e-5), misfit=misfit)


def cycle(phase, *forces, shape=None):
    touches = tuple(Touch(0.0, 0.0, force, 0.01, force > 0.02, shape=shape) for force in forces)
    return SimpleNamespace(touch=touches, sent=SimpleNamespace(phase=phase))


def test_the_shape_in_the_last_image_of_the_hold_is_reported():
    contacts = HeldContacts()
    for phase, force, kind in (
        ("regulate", 0.13, "smooth"),
        ("hold", 0.4, "edge"),
        ("hold", 0.5, "flat"),
        ("release", 0.2, "smooth"),
    ):
        contacts.add(cycle(phase, force, 0.0, shape=of_kind(kind)))
    fingers = [FittedPipeline(), FittedPipeline()]
    found, other = contacts.estimate(fingers)
    assert other is None  # it never touched
    assert not any(finger.asked for finger in fingers)
    assert found["kind"] == "flat" and found["probability"] == 0.8
    assert found["area_mm2"] == pytest.approx(40)
    np.testing.assert_allclose(found["area_interval_mm2"], [30, 60])


def test_a_history_that_does_not_explain_the_hold_is_discarded():
    contacts = HeldContacts()
    contacts.add(cycle("hold", 0.6, shape=of_kind("flat", misfit=3.3)))
    finger = FittedPipeline()
    (found,) = contacts.estimate([finger])
    assert finger.asked == [[0.6]]
    assert found["kind"] == "smooth" and found["misfit"] == 0.9


def test_a_shape_with_a_poor_fit_uses_the_area_of_the_traction():
    shape = ContactShape("flat", dict.fromkeys(SHAPES, 0.2), area=4e-5, misfit=3.3)
    mask = np.ones((2, 2), dtype=bool)
    patch = Contact(True, 9e-5, np.zeros(2), 1e-3, mask, area_interval=np.array([4e-5, 1.6e-4]))
    (touch,) = cycle("hold", 0.6, shape=shape).touch
    contacts = HeldContacts()
    contacts.add(
        SimpleNamespace(touch=(replace(touch, contact=patch),), sent=SimpleNamespace(phase="hold"))
    )
    (found,) = contacts.estimate([FittedPipeline("smooth", misfit=4.0)])
    assert found["kind"] == "flat" and found["area_mm2"] == pytest.approx(90)
    np.testing.assert_allclose(found["area_interval_mm2"], [40, 160])


def test_an_unknown_shape_stays_unknown():
    shape = ContactShape("unknown", dict.fromkeys(SHAPES, np.nan))
    contacts = HeldContacts()
    contacts.add(cycle("hold", 0.4, shape=shape))
    finger = FittedPipeline()
    (found,) = contacts.estimate([finger])
    assert not finger.asked and found["kind"] == "unknown" and np.isnan(found["area_mm2"])


def test_synthetic_touch_has_no_contact_shape():
    contacts = HeldContacts()
    contacts.add(cycle("hold", 0.4))
    assert contacts.estimate([object()]) == (None,)
