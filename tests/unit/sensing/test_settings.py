"""Tests of the pipeline's fitted settings: each documents its meaning and source, and an override
by name has an effect."""

import dataclasses
import json
import math
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.renamed import SETTINGS
from mjtactile.core.types import Traction
from mjtactile.sensing.force import contact_detection
from mjtactile.sensing.image.markers import detect
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sensing.settings import DEFAULTS
from mjtactile.sensing.settings.tunable_parameter import GAUGED, PRESSED, SEEN, TRIED
from mjtactile.sensing.touch.material import estimate_material
from mjtactile.sensing.touch.squeeze import Squeeze

TRIALS = (TRIED, GAUGED, SEEN, PRESSED)


def stages():
    return [value for value in vars(DEFAULTS).values() if dataclasses.is_dataclass(value)]


def test_every_setting_has_a_description_and_a_source():
    for owner in (DEFAULTS, *stages()):
        for field in dataclasses.fields(owner):
            if not dataclasses.is_dataclass(getattr(owner, field.name)):
                assert field.metadata["meaning"] and field.metadata["source"], field.name
                allowed = field.metadata["file"]
                for value in np.atleast_1d(field.default):
                    assert allowed.low <= value <= allowed.high, field.name
                # sensitivities are evaluated at half and twice the value
                assert allowed.integer or allowed.low < allowed.high / 4, field.name


def test_a_tuned_setting_has_its_row_on_the_page():
    page = (Path(__file__).parents[3] / "docs/reference/parameters.md").read_text()
    tried = {
        f"{stage}.{field.name}".lstrip(".")
        for stage, owner in (("", DEFAULTS), *vars(DEFAULTS).items())
        if dataclasses.is_dataclass(owner)
        for field in dataclasses.fields(owner)
        if any(text in field.metadata.get("source", "") for text in TRIALS)
    }
    # if it fails: mjtactile bench setting-sensitivity (or gauge, seen, bodies) --readme
    # docs/reference/parameters.md
    shown = set(re.findall(r"^\| `([\w.]+)` \|", page, re.M))
    (quiet,) = re.findall(r"parameters; (\d+) change little or nothing here and are left out", page)
    assert shown <= tried and len(shown) + int(quiet) == len(tried)


def test_an_override_changes_no_default_and_no_other_setting():
    other = DEFAULTS.override(
        {"zero.touch_min": 0.5, "inverse.spans": (12, 8), "min_detected": 0.7}
    )
    changed = {key for key, value in other.to_dict().items() if DEFAULTS.to_dict()[key] != value}
    assert (
        changed == {"zero.touch_min", "inverse.spans", "min_detected"}
        and DEFAULTS.zero.touch_min == 0.02
    )


def test_a_pipeline_uses_its_settings():
    sensing_pipeline = SensingPipeline(
        load_sensor("paper16"),
        settings=DEFAULTS.override({"inverse.spans": (10, 8), "surface.laplacian": 200.0}),
    )
    assert (len(sensing_pipeline.inverse.x), len(sensing_pipeline.inverse.y)) == (11, 9)
    assert not np.allclose(
        sensing_pipeline.fitter.prior, SensingPipeline(load_sensor("paper16")).fitter.prior
    )
    press = Traction(
        np.zeros(2),
        np.zeros(2),
        np.zeros((2, 2, 3)),
        -np.array([0, 0, 0.3, 0, 0, 0]),
        1e-6 * np.eye(6),
        0.0,
        "",
    )
    deaf = sensing_pipeline.settings.override({"zero.touch_min": 0.5}).zero
    assert (
        contact_detection.detect_touch(1.0, press, None).touching
        and not contact_detection.detect_touch(1.0, press, None, deaf).touching
    )


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"zero.tuch_sd": 1.0}, r"zero\.tuch_sd: unknown setting \(valid: zero\.touch_sd, "),
        ({"nil.touch_sd": 1.0}, r"unknown setting \(valid: min_detected, markers"),
        ({"zero": 1.0}, "unknown setting"),
        ({"body.log_body": 3.0}, "`body.log_body` is now `contact_shape.log_shape`"),
        ({"gauge.floor": 1.5}, "`gauge.floor` is now `gas_filter.floor`"),
        ({"inverse.knock_min": 6.0}, "`inverse.knock_min` is now `inverse.displaced_min`"),
        ({"zero.touch_sd": math.nan}, "nan is outside 0.05 to 500"),
        ({"zero.touch_sd": "5"}, "'5' is not a number"),
        ({"zero.memory_images": 1.5}, "1.5 is not a whole number"),
        ({"inverse.spans": (14,)}, "is not a list of 2 numbers"),
        ({"inverse.spans": (14, 2)}, r"inverse\.spans\[1\]: 2 is outside 4 to 40"),
        ({"identity.neighbours": 65}, r"identity\.neighbours: 65 is outside 1 to 64"),
        (
            {"exhaustive_detection.scale_step": 1},
            r"exhaustive_detection\.scale_step: 1 is outside 2 to 300",
        ),
        ({"zero.touch_min": -0.02}, "-0.02 is outside 0.0002 to 2"),
    ],
)
def test_a_wrong_name_or_value_is_refused(values, message):
    with pytest.raises(InputError, match=message):
        DEFAULTS.override(values)


def test_every_new_name_of_a_setting_exists():
    sections = {name for name, stage in vars(DEFAULTS).items() if dataclasses.is_dataclass(stage)}
    assert set(SETTINGS.values()) <= DEFAULTS.to_dict().keys() | sections
    assert not set(SETTINGS) & (DEFAULTS.to_dict().keys() | sections)


def test_settings_are_recorded_as_json():
    assert json.loads(json.dumps(DEFAULTS.to_dict()))["zero.touch_min"] == 0.02


def test_every_stage_uses_its_settings():
    """One setting of each stage that a grasp does not reach is changed until its result changes."""
    sample = np.arange(60) / 30
    # 2 kN/m, pressed for 0.8 s, then held
    force = np.minimum(sample, 0.8)
    width = 0.02 - 5e-4 * np.minimum(sample, 0.8)
    squeeze = Squeeze(
        sample, width, force, np.full(60, 3e-3), width, np.full(60, 2e-5), np.full(60, 3e-4)
    )
    hard = DEFAULTS.override({"material.solid_compliance": 1e-3}).material
    assert (
        estimate_material(squeeze).probability["solid"] < 0.1
        and estimate_material(squeeze, hard).kind == "solid"
    )
    image = cv2.GaussianBlur(
        cv2.circle(np.full((120, 160), 200, np.uint8), (80, 60), 20, 40, -1), (0, 0), 1.0
    )
    blind = DEFAULTS.override({"candidates.margins": (250.0, 250.0)})
    assert (len(detect(image)), len(detect(image, settings=blind))) == (1, 0)
    sure = DEFAULTS.override(
        {"profiles.covariance_factor": 4 * DEFAULTS.profiles.covariance_factor}
    )
    # the levels' part stays
    assert (
        1.5 < np.sqrt(detect(image, settings=sure).cov[0, 2, 2] / detect(image).cov[0, 2, 2]) <= 2
    )
