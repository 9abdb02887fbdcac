"""Tests of fiducials on the rim of a round sensor: valid positions, the gas behind the lip, and a
camera shift."""

import numpy as np
import pytest

from mjtactile.core import resources
from mjtactile.core.config_fields import from_table
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.rig.camera_faults import CameraFaults
from mjtactile.sensing.stateful_pipeline import StatefulPipeline
from mjtactile.sim.rendering.image_faults import FaultyImage
from tests import membrane_images

ANGLES = np.radians([0, 25, 50, 130, 155, 180, 205, 230, 310, 335])  # in the image, with a margin


def write(folder, radius_mm, quiet_zone_mm=0.45):
    """Return the shipped round sensor, its rim wider, with fiducials on a circle."""
    text = resources.find("round30", "models/sensors", ".toml").read_text("utf-8")
    around = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
    places = (radius_mm * around).round(3).tolist()
    text = text.replace("wall_mm = 3.0 ", "wall_mm = 4.5 ")
    path = folder / "round.toml"
    path.write_text(
        f"{text}\n[fiducials]\nsurface = 'rim'\nradius_mm = 0.8\npositions_mm = {places}\n"
        f"quiet_zone_mm = {quiet_zone_mm}\nlip_mm = 1.0\nwall_setback_mm = 3.2\n"
    )
    return str(path)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write(tmp_path_factory.mktemp("round"), 16.3)


def test_the_groove_is_a_ring_of_gas(path):
    design = load_sensor(path)
    ring = np.pi * (18.2**2 - 15.0**2) * 1e-6
    flat = np.pi * 15e-3**2 * design.chamber.depth
    groove = design.fiducials.groove(design)
    # setback at which the line of sight to a circle's outer edge, 17.55 mm out, passes the
    # opening's
    assert groove == pytest.approx(
        (1 - 15 / 17.55) * (design.camera.distance - 1e-3), rel=1e-3
    )  # chords
    assert design.chamber_volume_flat - flat == pytest.approx(ring * groove, rel=1e-5)


@pytest.mark.parametrize(("radius_mm", "quiet_zone_mm"), [(16.2, 0.45), (17.2, 0.45)])
def test_circles_beside_the_lip_are_refused(tmp_path, radius_mm, quiet_zone_mm):
    with pytest.raises(InputError, match=r"not on the lip|outside the image"):
        load_sensor(write(tmp_path, radius_mm, quiet_zone_mm))


def touches(path, change=lambda image: image):
    images = membrane_images.sequence(path)
    sensor = StatefulPipeline.of(load_sensor(path))
    sensor.measure_flat_reference(images.flat)
    sensor.measure_rest_reference(images.rest, membrane_images.GAUGE)
    shown = (images.rest[0], images.pressed[1])
    return [[sensor.perceive(change(item), item.time) for _ in range(2)][-1] for item in shown]


@pytest.mark.slow
def test_a_shifted_camera_is_known(path):
    table = {"image_shift_px": [4.0, 3.0], "rotation_deg": 0.3, "scale_percent": 0.2}
    shifted = FaultyImage(from_table(CameraFaults, table, "test"))
    for now, then in zip(touches(path, shifted), touches(path), strict=True):
        assert now.status == "ok"
        assert now.camera.seen == len(ANGLES)
        # from circles 16 mm from the center; on `dense_fiducials` they are at 22 mm, and the error
        # is 0.03
        assert now.camera.shift == pytest.approx((4.0, 3.0), abs=0.1)
        # three of a clean image's sds, as on `dense_fiducials`
        assert abs(now.force_normal - then.force_normal) < 0.03
