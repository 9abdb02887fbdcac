"""Tests of mesh files: all formats give the same solid, hollows are detected and decomposed into
convex parts, and a hull is reported."""

import struct
import sys

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.sim.scenes import convex_cut, meshes
from mjtactile.sim.scenes.indentation import Indenter, PressWorld
from mjtactile.sim.sensor.feature_size import filled_fraction

CORNERS = np.array([(0, 0), (12, 0), (12, 4), (4, 4), (4, 12), (0, 12)], float)  # of an L, mm
HEIGHT = 5.0
CAP = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
AREA = 12 * 4 + 4 * 8  # mm^2; of its convex hull: the corner between (12, 4) and (4, 12) is cut off
HULL = 12 * 12 - 8 * 8 / 2


def prism():
    """Return triangles (m, 3, 3) mm of the L, outside first."""
    low, high = (np.c_[CORNERS, np.full(6, z)] for z in (0.0, HEIGHT))
    sides = [
        t
        for i in range(6)
        for j in [(i + 1) % 6]
        for t in ((low[i], low[j], high[j]), (low[i], high[j], high[i]))
    ]
    return np.array([*[low[list(t)][::-1] for t in CAP], *[high[list(t)] for t in CAP], *sides])


def binary(path):
    parts = [struct.pack("<12fH", 0, 0, 0, *t.ravel(), 0) for t in prism()]
    path.write_bytes(b"an L".ljust(80) + struct.pack("<I", len(parts)) + b"".join(parts))


def ascii_stl(path):
    facets = [
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in t)
        + "endloop\nendfacet\n"
        for t in prism()
    ]
    path.write_text("solid L\n" + "".join(facets) + "endsolid L\n")


def obj(path):
    corners = prism().reshape(-1, 3)
    path.write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in corners)
        + "".join(f"f {k + 1} {k + 2} {k + 3}\n" for k in range(0, len(corners), 3))
    )


WRITERS = [("binary.stl", binary), ("text.stl", ascii_stl), ("mesh.obj", obj)]


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.mark.parametrize(("name", "write"), WRITERS)
def test_every_format_is_the_same_solid(name, write, tmp_path):
    write(tmp_path / name)
    vertices, faces = meshes.load_solid(tmp_path / name)
    assert vertices.shape == (12, 3) and len(faces) == 20  # every corner once
    np.testing.assert_allclose(
        np.sort(vertices, axis=0),
        np.sort(np.unique(prism().reshape(-1, 3), axis=0), axis=0) * 1e-3,
        atol=1e-8,
    )  # MuJoCo keeps them in single precision
    assert filled_fraction(vertices, faces) == pytest.approx(AREA / HULL, rel=1e-5)


def test_a_hollow_is_decomposed_once_and_cached(tmp_path, cache):
    pytest.importorskip("coacd")
    obj(tmp_path / "l.obj")
    solid = meshes.load_solid(tmp_path / "l.obj")
    parts = meshes.convex_parts(solid)
    assert len(parts) == 2 and all(filled_fraction(*part) > 0.999 for part in parts)
    volumes = [filled_fraction(*part) * volume(*part) for part in parts]
    # CoACD cuts where it samples
    assert sum(volumes) == pytest.approx(AREA * HEIGHT * 1e-9, rel=0.02)
    before = list(cache.rglob("*.npz"))
    again = meshes.convex_parts(solid)
    assert len(before) == 1 and all(
        np.array_equal(a[0], b[0]) for a, b in zip(parts, again, strict=True)
    )


def volume(vertices, faces):
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6


def press_flags(path):
    world = PressWorld(load_sensor("dense"), Indenter.parse(str(path)), mesh=(9, 7))
    world.inflate(1000.0, seal=True)
    world.press(1e-3)
    return world.flags


def test_an_approximation_by_the_hull_is_reported(tmp_path, monkeypatch, cache):
    binary(tmp_path / "l.stl")
    monkeypatch.setitem(sys.modules, "coacd", None)  # not installed
    flags = press_flags(tmp_path / "l.stl")
    assert "fills 71%" in flags["hull"] and "mjtactile[meshes]" in flags["hull"]
    monkeypatch.undo()
    pytest.importorskip("coacd")
    assert "hull" not in press_flags(tmp_path / "l.stl")


def test_a_mesh_that_cannot_be_decomposed_in_time_is_refused(tmp_path, monkeypatch, cache):
    """CoACD runs for minutes on an open surface; no signal interrupts it."""
    pytest.importorskip("coacd")
    monkeypatch.setattr(convex_cut, "TIME", 3.0)
    path = tmp_path / "open.stl"
    parts = [struct.pack("<12fH", 0, 0, 0, *t.ravel(), 0) for t in prism()[4:]]
    path.write_bytes(b"open".ljust(80) + struct.pack("<I", len(parts)) + b"".join(parts))
    with pytest.raises(InputError, match="is not cut into convex parts within 3 s: close its"):
        meshes.convex_parts(meshes.load_solid(path))
    assert not list(cache.rglob("*.npz"))


def test_a_mesh_in_another_unit_is_refused(tmp_path):
    """12 mm in a file in um; the limits are those of other indenters."""
    path = tmp_path / "l.stl"
    parts = [struct.pack("<12fH", 0, 0, 0, *(1e3 * t).ravel(), 0) for t in prism()]
    path.write_bytes(b"an L".ljust(80) + struct.pack("<I", len(parts)) + b"".join(parts))
    with pytest.raises(
        InputError, match=r"is 12000 mm wide; a shape of 0\.01 to 1000 mm is needed"
    ):
        meshes.load_solid(path)


@pytest.mark.parametrize(
    ("geom", "message"),
    [('size="nan"', "does not compile"), ('size="0.01" pos="0 nan 0"', "is nan, not finite")],
)
def test_an_indenter_that_is_not_finite_is_refused(tmp_path, geom, message):
    (tmp_path / "a.xml").write_text(f"<mujoco><worldbody><geom {geom}/></worldbody></mujoco>")
    with pytest.raises(InputError, match=message):
        PressWorld(load_sensor("dense"), Indenter.parse(str(tmp_path / "a.xml")), mesh=(9, 7))


@pytest.mark.parametrize("text", ["", "solid nothing\nendsolid\n", "vertex 1 2 3\n" * 12])
def test_a_missing_mesh_is_reported_in_one_line(text, tmp_path):
    (tmp_path / "part.stl").write_text(text)
    with pytest.raises(InputError) as error:
        meshes.load_solid(tmp_path / "part.stl")
    assert "part.stl" in str(error.value) and "\n" not in str(error.value)
