"""Fixture of quicker fits."""

import pytest

from mjtactile.explore import surface_fusion
from mjtactile.explore.shape_models import FAMILIES


@pytest.fixture
def two_families(monkeypatch):
    """Fit two of the six families; tests of the choice between families fit all of them."""
    families = [family for family in FAMILIES if family.name in ("ellipsoid", "box")]
    assert len(families) == 2
    monkeypatch.setattr(surface_fusion, "FAMILIES", families)
