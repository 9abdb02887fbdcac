"""The import contracts hold, and each of them catches a violation (so none of them passes by being
empty)."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]

VIOLATIONS = {
    "Layers": ("mjtactile/core/types/felt.py", "import mjtactile.rig.file"),
    "Layers (a new module without a place)": ("mjtactile/stray.py", ""),
    "Core, from the ground up": ("mjtactile/core/types/felt.py", "import mjtactile.core.design"),
    "Values, from the image": ("mjtactile/core/types/seen.py", "import mjtactile.core.types.felt"),
    "Sensing, from the image up": (
        "mjtactile/sensing/image/edges.py",
        "import mjtactile.sensing.force.sheet",
    ),
    "Simulation, from the sensor up": (
        "mjtactile/sim/sensor/gas.py",
        "import mjtactile.sim.scenes.world",
    ),
    "The product imports no benchmark": (
        "mjtactile/commands/press.py",
        "import benchmarks.speed.run",
    ),
    "Sensing meets": ("mjtactile/sensing/pose/circles.py", "import mjtactile.rig.registry"),
    "Only the simulator": ("mjtactile/run/loop.py", "import mujoco"),
    "Fitting, from": ("mjtactile/fit/evidence.py", "import mjtactile.fit.run"),
    "A controller sees": ("controllers/gentle.py", "import mjtactile.core.design"),
    "A controller sees (no simulator)": ("controllers/gentle.py", "import mujoco"),
    "Examples use": ("examples/touch_in_my_scene.py", "import mjtactile.sim.attach"),
    "Commands use": ("mjtactile/commands/press.py", "import mjtactile.sim.scenes.indentation"),
    "Ground truth": ("mjtactile/run/loop.py", "import mjtactile.sim.truth"),
}


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    folder = tmp_path_factory.mktemp("contracts")
    for name in ("mjtactile", "benchmarks", "controllers", "examples"):
        shutil.copytree(
            CHECKOUT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__")
        )
    shutil.copy(CHECKOUT / "pyproject.toml", folder)
    return folder


# The checkout is on the path of an editable install; `controllers` would be found in both places.
LINT = f"""
import sys
sys.path[:] = ["."] + [path for path in sys.path[1:] if path != {str(CHECKOUT)!r}]
from importlinter.cli import lint_imports
sys.exit(lint_imports(no_cache=True))
"""


def lint(folder):
    """Run import-linter on the code in `folder`."""
    return subprocess.run(
        [sys.executable, "-c", LINT], cwd=folder, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("contract", VIOLATIONS)
def test_a_violation_is_caught(copy, contract):
    name, line = VIOLATIONS[contract]
    path = copy / name
    original = path.read_text() if path.exists() else None
    path.write_text(f"{original or ''}\n{line}\n")
    try:
        result = lint(copy)
    finally:
        path.unlink() if original is None else path.write_text(original)
    assert result.returncode == 1
    broken = [
        text for text in result.stdout.splitlines() if text.endswith("BROKEN") or "BROKEN" in text
    ]
    assert any(text.startswith(contract.split(" (")[0][:16]) for text in broken), result.stdout
