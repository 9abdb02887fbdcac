"""Tests of a status: text with a code that survives comparison, copies, pickles, JSON and
arrays."""

import copy
import json
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core.status import OK, Status, StatusCode
from mjtactile.core.types import Touch

FEW = Status(StatusCode.TOO_FEW_MARKERS, "only 3 of 81 markers seen")


@pytest.mark.parametrize("way", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
@pytest.mark.parametrize("status", [OK, FEW])
def test_text_and_code_agree(way, status):
    again = way(status)
    assert again == status and again.code is status.code and type(again) is Status


def test_a_status_is_text_in_json_and_arrays():
    assert json.dumps([OK, FEW, FEW.code]) == (
        '["ok", "only 3 of 81 markers seen", "too few markers"]'
    )
    assert (np.array([OK, FEW]) == "ok").tolist() == [True, False]
    assert f"{FEW}" == "only 3 of 81 markers seen" and repr(OK) == "'ok'"


def test_every_touch_has_a_status_code():
    touch = Touch(0.0, 0.0, math.nan, math.nan, False)
    assert touch.status.code is StatusCode.OK
    assert replace(touch, status=FEW).status.code is StatusCode.TOO_FEW_MARKERS
    assert replace(touch, status="too dark").status.code is StatusCode.OTHER
    assert replace(touch, status="ok").status.code is StatusCode.OK
