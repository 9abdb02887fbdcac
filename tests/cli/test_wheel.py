"""Tests of the packages of an index outside the checkout. The source distribution builds, and its
wheel has a tag that an index accepts. In a fresh environment it grasps an egg.
"""

import contextlib
import importlib.metadata
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from importlib.util import cache_from_source
from pathlib import Path

import pytest

from mjtactile.kernels import build
from tests.emulated_host import controller_text

CHECKOUT = Path(__file__).resolve().parents[2]
# of one worker: it builds the wheel once
pytestmark = [pytest.mark.slow(25), pytest.mark.xdist_group("a wheel")]
BUILD_ONLY = ("hatchling", "pathspec", "trove-classifiers", "ziglang")
"""Packages of the lock that only the build needs; a wheel contains its compiled library."""
GLIBC = (2, 17)  # version guaranteed by the tag manylinux_2_17


def run(*command, code=0, variables=(), **options):
    """Return a command's stdout and stderr.

    Python's path contains no folder of this checkout or environment.
    """
    environment = {
        key: value
        for key, value in os.environ.items()
        if key not in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    }
    result = subprocess.run(
        [str(part) for part in command],
        env=environment | dict(variables),
        capture_output=True,
        text=True,
        timeout=1200,
        check=False,
        **options,
    )
    assert result.returncode == code, f"{result.stdout}\n{result.stderr}"
    return result.stdout, result.stderr


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """Provide the source distribution."""
    folder = tmp_path_factory.mktemp("source")
    run(sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", folder, cwd=CHECKOUT)
    (made,) = folder.iterdir()
    return made


@pytest.fixture(scope="module")
def wheel(source, tmp_path_factory):
    """Build the wheel from the source distribution, not from the checkout.

    The library for this processor is copied from the checkout, whose set-up compiled it from the
    same sources with the same command (its name contains their hash). The others are compiled
    here.
    """
    folder = tmp_path_factory.mktemp("wheel")
    cache = tmp_path_factory.mktemp("cache")
    (cache / "mjtactile").mkdir()
    shutil.copy(build.library(), cache / "mjtactile")
    pip = (sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation")
    run(*pip, "--wheel-dir", folder, source, variables={"XDG_CACHE_HOME": str(cache)})
    (made,) = folder.iterdir()
    return made


def link_locked(site):
    """Link all run-time packages of the lock into another environment.

    pip has unpacked them for this one. Unpacking them again would take longer than the whole
    test.
    """
    for line in (CHECKOUT / "requirements.lock").read_text().splitlines():
        if line.startswith(("#", *BUILD_ONLY)):
            continue
        name, _, version = line.partition("==")
        distribution = importlib.metadata.distribution(name)
        assert distribution.version == version, name
        for file in distribution.files:
            if ".." in file.parts:  # scripts
                continue
            # a module's bytecode exists once it has been imported
            for item in (file, *[cache_from_source(str(file))] * (file.suffix == ".py")):
                target = site / item
                if not target.exists():  # a file may be in two packages
                    target.parent.mkdir(parents=True, exist_ok=True)
                    with contextlib.suppress(FileNotFoundError):
                        link(distribution.locate_file(item), target)


def link(source, target):
    try:
        os.link(source, target)
    except OSError:  # on another disk
        shutil.copy2(source, target)


def glibc_needed(library):
    """Return the newest version of glibc symbols that a library requires, from its string table."""
    return max((int(a), int(b)) for a, b in re.findall(rb"GLIBC_(\d+)\.(\d+)", library))


def test_the_source_distribution_is_complete(source):
    with tarfile.open(source) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    for needed in ("pyproject.toml", "hatch_build.py", "Makefile", "requirements.lock", "LICENSE"):
        assert needed in names
    for folder in ("mjtactile", "benchmarks", "models", "controllers", "examples", "tests", "docs"):
        assert any(name.startswith(f"{folder}/") for name in names), folder
    assert not [name for name in names if name.endswith((".so", ".pyc"))]


def test_the_wheel_tag_is_that_of_its_libraries(wheel):
    """The wheel's tag is one that an index accepts, and no library in it needs a newer system than
    the tag states."""
    tag = build.PLATFORMS[build.this_platform()][1]
    assert wheel.name.endswith(f"-py3-none-{tag}.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        libraries = {name: archive.read(name) for name in names if name.endswith(".so")}
        (metadata,) = (archive.read(n).decode() for n in names if n.endswith("/WHEEL"))
    # the compressed set of the name is spelled out inside
    spelled = re.findall("^Tag: (.*)$", metadata, re.M)
    assert sorted(spelled) == sorted(f"py3-none-{item}" for item in tag.split("."))
    assert len(libraries) == len(build.instruction_sets(build.this_platform()))
    if tag.startswith("manylinux"):
        for name, library in libraries.items():
            assert glibc_needed(library) <= GLIBC, name
    top = {name.partition("/")[0] for name in names}
    assert {name for name in top if not name.endswith(".dist-info")} == {"mjtactile"}
    # the command is kept, to report the location of the benchmarks
    assert "mjtactile/commands/bench.py" in names


@pytest.mark.skipif(build.this_platform() != "linux-x86_64", reason="of x86-64's instruction sets")
@pytest.mark.skipif(not shutil.which("objdump"), reason="no disassembler here")
@pytest.mark.parametrize(("instructions", "has_wide"), [("sse2", False), ("avx2", True)])
def test_the_library_uses_only_the_baseline_instruction_set(
    wheel, tmp_path, instructions, has_wide
):
    """The processor that compiles may have more instructions than the processor that runs the
    library."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (n for n in archive.namelist() if n.endswith(f"-{instructions}.so"))
        library = archive.extract(name, tmp_path)
    text, _ = run("objdump", "-d", "--no-show-raw-insn", library)
    assert ("%ymm" in text) == has_wide
    assert "%zmm" not in text


def test_a_wheel_of_another_platform_is_built(tmp_path):
    """The wheel has the tag and one library of the other platform."""
    target = "darwin-arm64"
    build_wheel = (sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path)
    run(*build_wheel, cwd=CHECKOUT, variables={"MJTACTILE_WHEEL": target})
    (made,) = tmp_path.iterdir()
    assert made.name.endswith(f"-py3-none-{build.PLATFORMS[target][1]}.whl")
    with zipfile.ZipFile(made) as archive:
        (library,) = (archive.read(n) for n in archive.namelist() if n.endswith(".so"))
    arm64 = 0x0100000C  # cputype
    assert library[:4] == bytes.fromhex("cffaedfe")
    assert int.from_bytes(library[4:8], "little") == arm64


def test_a_wheel_for_an_unknown_platform_is_refused(tmp_path):
    command = (sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path)
    _, reported = run(*command, cwd=CHECKOUT, code=1, variables={"MJTACTILE_WHEEL": "amiga"})
    assert "MJTACTILE_WHEEL=amiga: choose from linux-x86_64, " in reported


def test_the_wheel_grasps_an_egg_in_a_fresh_environment(wheel, tmp_path):
    fresh = tmp_path / "venv"
    python = fresh / "bin" / "python"
    mjtactile = fresh / "bin" / "mjtactile"
    work = tmp_path / "work"
    work.mkdir()
    run(sys.executable, "-m", "venv", "--without-pip", fresh)
    link_locked(Path(sysconfig.get_path("purelib", vars={"base": fresh, "platbase": fresh})))
    pip = (sys.executable, "-m", "pip", "--python", python, "--quiet")
    install = ("--disable-pip-version-check", "install", "--no-deps", "--no-compile")
    run(*pip, *install, wheel, cwd=work)
    where, _ = run(python, "-c", "import mjtactile; print(mjtactile.__file__)", cwd=work)
    assert Path(where.strip()).is_relative_to(fresh)
    pages = json.loads(run(mjtactile, "docs", "--json", cwd=work)[0])
    assert (
        Path(pages["folder"]).is_relative_to(fresh) and "reference/sensor_files" in pages["pages"]
    )
    _, reported = run(mjtactile, "bench", "speed", cwd=work, code=2)
    assert reported == (
        "mjtactile: benchmarks are not in the installed package; run them from a checkout of the "
        "project's source, folder 'benchmarks' (pip install --editable .)\n"
    )
    quick = tmp_path / "quick.py"
    quick.write_text(controller_text(hold=0.1))
    grasp = (mjtactile, "grasp", "--sensor", "paper16", "--json", "--out", "egg")
    grasp += ("--controller", quick)
    summary = json.loads(run(*grasp, cwd=work)[0])
    assert summary["outcome"] == "held"
    assert {path.name for path in (work / "egg").iterdir()} == {
        "summary.json",
        "summary.png",
        "summary.html",
        "recording",
    }
    assert [path.name for path in work.iterdir()] == ["egg"]
