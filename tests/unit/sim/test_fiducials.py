"""Tests of fiducials in the simulated image."""

import tomllib

import numpy as np
import pytest

from mjtactile.core import optics, resources
from mjtactile.core.design import load_sensor, sensor_from_table
from mjtactile.sensing.image.markers import detect
from mjtactile.sim.rendering.renderer import Effects, Renderer
from mjtactile.sim.rendering.synthetic_ellipses import EllipseSampler
from tests.unit.core.test_fiducials import PANE

AROUND = np.linspace(0, 2 * np.pi, 720, endpoint=False)


def on_glass():
    path = resources.find("dense_fiducials", "models/sensors", ".toml")
    table = {**tomllib.loads(path.read_text("utf-8")), "fiducials": PANE}
    return sensor_from_table(table, name="on_glass", source="on_glass.toml")


def flat(design):
    return design.markers.p_SM, np.tile([0.0, 0.0, 1.0], (design.markers.count, 1))


def outlines(design):
    """Return areas (F,) px^2 and centroids (F, 2) px of the projected circles, by the shoelace
    formula."""
    camera = optics.Camera.from_design(design.camera, design.glass)
    rim = np.column_stack([np.cos(AROUND), np.sin(AROUND), 0 * AROUND])
    p = design.fiducials.p_SF(design)[:, None] + design.fiducials.radius * rim
    x, y = np.moveaxis(optics.project(camera, p - design.camera.p_SC), 2, 0)
    cross = x * np.roll(y, -1, 1) - np.roll(x, -1, 1) * y
    area = cross.sum(axis=1) / 2
    mean_x = ((x + np.roll(x, -1, 1)) * cross).sum(axis=1) / (6 * area)
    mean_y = ((y + np.roll(y, -1, 1)) * cross).sum(axis=1) / (6 * area)
    return np.abs(area), np.column_stack([mean_x, mean_y])


@pytest.mark.parametrize(
    ("design", "place", "size"),
    [(load_sensor("dense_fiducials"), 0.015, 0.06), (on_glass(), 0.05, 0.3)],
    ids=["rim", "glass"],
)
def test_fiducials_are_projected_through_lens_and_glass(design, place, size):
    """Rendered fiducials have the center and size of their outline through lens and glass.

    The bounds in px are the edge detector's bias at 0.7 px of blur, and at 2 px, where it reads
    beyond the ground.
    """
    quiet = Renderer(design).render(*flat(design), effects=Effects(noise_dn=0.0))
    found = detect(quiet)
    area, center = outlines(design)
    for a, c in zip(area, center, strict=True):
        off = np.linalg.norm(found.center_px - c, axis=1)
        nearest = int(np.nanargmin(off))
        assert off[nearest] < place
        radius = np.sqrt(found.semi_axes_px[nearest].prod())
        assert radius == pytest.approx(np.sqrt(a / np.pi), abs=size)


def test_fiducials_change_only_their_own_pixels():
    """Within the opening the image is that of a sensor without fiducials; the lip has the gray
    level of a membrane."""
    plain = load_sensor("dense")
    design = load_sensor("dense_fiducials")
    computed, reference = (
        Renderer(item).irradiance_image(*flat(item), effects=Effects()) for item in (design, plain)
    )
    camera = optics.Camera.from_design(plain.camera, plain.glass)
    half = [plain.frame.length / 2, plain.frame.width / 2, 0.0]
    low, high = (
        optics.project(camera, s * np.array(half) - plain.camera.p_SC).astype(int) for s in (-1, 1)
    )
    inside = (slice(low[1] + 6, high[1] - 5), slice(low[0] + 6, high[0] - 5))
    assert computed[inside] == pytest.approx(reference[inside], abs=1e-3)
    # between two circles of the left column: leds.membrane_DN, less the loss at the corners
    _, center = outlines(design)
    u, v = np.rint(center[:2].mean(axis=0)).astype(int)
    light = Renderer(design)._light.field(design.markers.p_SM)[v, u]
    assert computed[v, u] == pytest.approx(design.leds.membrane_dn * light, abs=0.5)


def test_synthetic_ellipses_include_fiducials():
    design = load_sensor("dense_fiducials")
    observed = EllipseSampler(design).sample(*flat(design)).ellipses
    assert len(observed) == design.markers.count + 10
    _, center = outlines(design)
    # sd 0.01 px
    assert observed.center_px[-10:] == pytest.approx(center, abs=0.1)
