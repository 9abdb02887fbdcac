"""Exploring without a simulator: an ellipsoid that answers exactly; files, resuming, stopping."""

from __future__ import annotations

import json
import math
import struct

import numpy as np
import pytest

from mjtactile.core.errors import InputError
from mjtactile.explore.compliance_map import ComplianceMap
from mjtactile.explore.exploration import PatchStore, explored
from mjtactile.explore.html_report import write_page
from mjtactile.explore.surface_export import write_ply, write_stl
from mjtactile.explore.surface_patch import Patch

RADIUS = 0.012


def patch(way, compliance=math.nan):
    """Return a patch on a ball of 12 mm."""
    way = np.asarray(way, float) / np.linalg.norm(way)
    near = way + np.random.default_rng(7).uniform(-0.15, 0.15, (12, 3))
    points = RADIUS * near / np.linalg.norm(near, axis=1)[:, None]
    free = (RADIUS + 3e-3) * way[None]
    return Patch(points, free, way, "smooth", 0.3, compliance, 1e-4)


@pytest.fixture(scope="module")
def ball():
    soft = [patch([0, 0, 1], 2e-3), patch([0, 0, -1], 0.0)]
    rest = [patch(direction) for direction in ([1, 0, 0], [0, 1, 0], [-1, -1, 0])]
    return explored([*soft, *rest], "touches", 5, {})


def test_report_of_a_ball(ball):
    reported = ball.summary()
    assert reported["size_mm"] == pytest.approx([24, 24, 24], rel=0.02)  # triangles of 0.8 mm
    assert reported["volume_mL"] == pytest.approx(4 / 3 * math.pi * 1.2**3, rel=0.03)
    assert reported["touches"] == reported["patches"] == 5
    # of two touches, one yielded by 2 mm/N and one by zero, with equal certainty
    assert reported["stiffness_N_m"] == pytest.approx(1e3)
    # each end has its own
    up = ball.mesh.vertices[:, 2] > 0.9 * RADIUS
    down = ball.mesh.vertices[:, 2] < -0.9 * RADIUS
    assert ball.stiffness.by_vertex[up].mean() > 20 * ball.stiffness.by_vertex[down].mean()


def test_without_deflection_stiffness_has_a_bound_and_unmeasured_is_unknown(ball):
    both = [patch([0, 0, 1], 0.0), patch([0, 0, -1], 0.0)]
    stiff = ComplianceMap.of(both, ball.mesh).summary()
    assert math.isnan(stiff["stiffness_N_m"])
    # two sd of the mean of two: 2 * 1e-4 / sqrt(2) m/N
    assert stiff["stiffness_min_N_m"] == pytest.approx(1 / (2e-4 / math.sqrt(2)))
    unseen = ComplianceMap.of([patch([0, 0, 1])], ball.mesh).summary()
    assert math.isnan(unseen["stiffness_N_m"]) and math.isnan(unseen["stiffness_min_N_m"])


def test_files_contain_the_surface(ball, tmp_path):
    write_ply(tmp_path / "a.ply", ball)
    head, _, rows = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    count = len(ball.mesh.vertices)
    assert f"element vertex {count}".encode() in head
    assert len(rows) == count * (8 * 4 + 3) + len(ball.mesh.triangles) * 13
    first = struct.unpack_from("<8f3B", rows)
    assert first[:3] == pytest.approx(1e3 * ball.mesh.vertices[0], rel=1e-5)
    write_stl(tmp_path / "a.stl", ball)
    data = (tmp_path / "a.stl").read_bytes()
    assert struct.unpack_from("<I", data, 80)[0] == len(ball.mesh.triangles)
    assert len(data) == 84 + 50 * len(ball.mesh.triangles)


def test_the_page_loads_no_other_file(ball, tmp_path):
    write_page(tmp_path / "a.html", ball, {**ball.summary(), "object": "<ball>"})
    page = (tmp_path / "a.html").read_text()
    assert "&lt;ball&gt;" in page
    assert "http" not in page and "src=" not in page
    data = json.loads(page.partition('id="data">')[2].partition("</script>")[0])
    assert len(data["touched"]) == 5
    assert {len(colours) for colours in data["colours"].values()} == {len(data["vertices"])}


def test_a_truncated_line_loses_only_its_touch(tmp_path):
    store = PatchStore(tmp_path / "touched.jsonl")
    for direction in ([0, 0, 1], [1, 0, 0]):
        store.write(patch(direction))
    before = store.path.read_text()
    store.path.write_text(before + before[:200])
    again = store.read()
    assert len(again) == 2
    assert again[1].points == pytest.approx(patch([1, 0, 0]).points)
    assert math.isnan(again[0].compliance)
    store.path.write_text("{}\n" + before)
    with pytest.raises(InputError, match="line 1 is not a patch"):
        store.read()
