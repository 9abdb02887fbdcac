"""The kernels' build and their Python face."""

import shutil
import subprocess
import sys

import numpy as np
import pytest

from mjtactile.kernels import bound, build, kernel
from mjtactile.kernels.bindings import declarations


def test_declared_and_exported_kernels_are_the_same():
    assert len(declarations()) > 30
    for name in declarations():
        assert callable(kernel(name))
    with pytest.raises(KeyError):
        kernel("no_such_kernel")


def test_outputs_must_match_and_inputs_are_converted():
    Q = np.diag([1.0, 1.0, -4.0])[None]
    poses = np.empty((4, 1, 3))
    # of radius 1 on x^2 + y^2 = 4 z^2: half a metre away
    kernel("circles_on_cones")(1, Q.astype(np.float32), [1], poses)
    np.testing.assert_allclose(poses[:2, 0], [[0, 0, 0.5]] * 2, atol=1e-12)
    for wrong in (
        np.empty((4, 1, 3), np.float32),
        np.empty((4, 3, 2))[..., :1],
        np.broadcast_to(0.0, (4, 1, 3)),
    ):
        with pytest.raises(
            TypeError,
            match="circles_on_cones: poses must be a writable C-contiguous array of float64",
        ):
            kernel("circles_on_cones")(1, Q, np.ones(1), wrong)


def test_a_bound_kernel_uses_the_given_arrays():
    p = np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]])
    triangles = np.array([[0, 1, 2]])
    gradient = np.empty((3, 3))
    volume = np.empty(1)
    of_these = bound("chamber_volume", 3, p, 1, triangles, gradient, volume)
    of_others = bound("chamber_volume", 3, ..., 1, triangles, gradient, volume)
    for z in (1.0, 2.0):
        p[:, 2] = z
        for function, given in ((of_these, ()), (of_others, (p.tolist(),))):
            volume[:] = np.nan
            assert function(*given) == 0
            # of a pyramid over it, from the origin
            assert volume[0] == pytest.approx(z * (1 / 2) / 3)
    with pytest.raises(
        TypeError, match="chamber_volume: triangles needs a copy of a int32 array of shape"
    ):
        bound("chamber_volume", 3, p, 1, triangles.astype(np.int32), gradient, volume)
    with pytest.raises(TypeError, match="bound"):
        of_these(p)
    with pytest.raises(ValueError, match="argument"):
        of_others(p, p)


@pytest.fixture
def copied(tmp_path):
    """Provide the package's sources in another folder, not built, without this user's cache."""
    shutil.copytree(
        build.FOLDER, tmp_path / "kernels", ignore=shutil.ignore_patterns(build.MADE, "__pycache__")
    )
    return tmp_path / "kernels"


def run_build(folder, text, tmp_path):
    code = f"import sys; sys.path.insert(0, {str(folder)!r}); import build; {text}"
    environment = {"PATH": "", "HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False
    )


def test_another_source_is_another_library(copied, tmp_path):
    names = []
    for line in ("", "/* changed */\n"):
        with (copied / "small.c").open("a") as source:
            source.write(line)
        names.append(run_build(copied, "print(build._hash())", tmp_path).stdout)
    assert names[0].strip() in build.library().name and names[1] != names[0]


def test_without_a_compiler_the_package_to_install_is_reported(copied, tmp_path):
    done = run_build(
        copied, "build.importlib.util.find_spec = lambda name: None; build.library()", tmp_path
    )
    assert "no C compiler: pip install ziglang" in done.stderr.splitlines()[-1]


@pytest.mark.slow
def test_a_compiler_error_is_reported(copied, tmp_path):
    for path in copied.glob("*.c"):
        path.unlink()
    (copied / "small.c").write_text("int wrong(void) { return nothing; }\n")
    done = run_build(copied, "build.library()", tmp_path)
    assert "do not compile" in done.stderr and "nothing" in done.stderr
    assert not list(copied.rglob("*.so"))
