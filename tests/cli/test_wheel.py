"""The wheel works outside the checkout: built, installed into a fresh environment, and grasping an
egg there."""

import json
import os
import subprocess
import sys
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[2]
BUILD_ONLY = ("hatchling", "pathspec", "trove-classifiers", "ziglang")
"""What the lock has for building; a wheel brings its compiled chain along."""


def run(*command, **options):
    """Run a command without anything of this checkout or environment on Python's path."""
    environment = {
        key: value
        for key, value in os.environ.items()
        if key not in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    }
    result = subprocess.run(
        [str(part) for part in command],
        env=environment,
        capture_output=True,
        text=True,
        timeout=1200,
        check=False,
        **options,
    )
    assert result.returncode == 0, f"{result.stdout}\n{result.stderr}"
    return result.stdout


def test_the_wheel_grasps_an_egg_in_a_fresh_environment(tmp_path):
    wheels = tmp_path / "wheels"
    fresh = tmp_path / "venv"
    work = tmp_path / "work"
    work.mkdir()
    run(
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "--wheel-dir",
        wheels,
        CHECKOUT,
    )
    run(sys.executable, "-m", "venv", fresh)
    pip = (
        fresh / "bin" / "python",
        "-m",
        "pip",
        "--quiet",
        "--disable-pip-version-check",
        "install",
    )
    locked = [
        line
        for line in (CHECKOUT / "requirements.lock").read_text().splitlines()
        if not line.startswith(("#", *BUILD_ONLY))
    ]
    run(*pip, "--no-compile", "--no-deps", *locked)
    run(*pip, "--no-deps", *wheels.glob("mjtactile-*.whl"), cwd=work)
    where = run(
        fresh / "bin" / "python", "-c", "import mjtactile; print(mjtactile.__file__)", cwd=work
    ).strip()
    assert Path(where).is_relative_to(fresh)
    pages = json.loads(run(fresh / "bin" / "mjtactile", "docs", "--json", cwd=work))
    assert Path(pages["folder"]).is_relative_to(fresh) and "sensors" in pages["pages"]
    summary = json.loads(
        run(
            fresh / "bin" / "mjtactile",
            "grasp",
            "--sensor",
            "paper16",
            "--json",
            "--out",
            "egg",
            cwd=work,
        )
    )
    assert summary["outcome"] == "held"
    assert {path.name for path in (work / "egg").iterdir()} == {
        "summary.json",
        "summary.png",
        "summary.html",
        "recording",
    }
    assert [path.name for path in work.iterdir()] == ["egg"]
