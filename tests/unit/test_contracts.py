"""The import contracts hold, and each of them catches a violation (so none of them passes by being
empty)."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]

VIOLATIONS = {
    "Layers": ("mjtactile/core/types/touch.py", "import mjtactile.rig.file"),
    "Layers (a new module without a place)": ("mjtactile/stray.py", ""),
    "Core layers": ("mjtactile/core/types/touch.py", "import mjtactile.core.design"),
    "Value layers": ("mjtactile/core/types/vision.py", "import mjtactile.core.types.touch"),
    "Sensing layers": (
        "mjtactile/sensing/image/edge_fit.py",
        "import mjtactile.sensing.force.spline_fem",
    ),
    "Simulation layers": ("mjtactile/sim/sensor/gas.py", "import mjtactile.sim.scenes.world"),
    "The product imports no benchmark": (
        "mjtactile/commands/press.py",
        "import benchmarks.speed.run",
    ),
    "Sensing imports": ("mjtactile/sensing/pose/circles.py", "import mjtactile.rig.registry"),
    "Only the simulator": ("mjtactile/runtime/control_loop.py", "import mujoco"),
    "Fit layers": ("mjtactile/fit/measurements.py", "import mjtactile.fit.identification"),
    "Controllers import": ("controllers/gentle.py", "import mjtactile.core.design"),
    "Controllers import (no simulator)": ("controllers/gentle.py", "import mujoco"),
    "Examples use": ("examples/touch_in_my_scene.py", "import mjtactile.sim.attach"),
    "Commands import": ("mjtactile/commands/press.py", "import mjtactile.sim.scenes.indentation"),
    "Ground truth": ("mjtactile/runtime/control_loop.py", "import mjtactile.sim.ground_truth"),
}


# A checkout is on the path of an editable install; `controllers` would be found in both places.
LINT = """
import os, sys
sys.path[:] = ["."] + [path for path in sys.path[1:] if not os.path.isdir(f"{path}/controllers")]
from importlinter.cli import lint_imports
sys.exit(lint_imports(no_cache=True))
"""


@pytest.fixture(scope="module")
def reported(tmp_path_factory):
    """Return import-linter's message for each contract, by its name, about a copy with all
    violations."""
    folder = tmp_path_factory.mktemp("contracts")
    for name in ("mjtactile", "benchmarks", "controllers", "examples"):
        shutil.copytree(
            CHECKOUT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__")
        )
    shutil.copy(CHECKOUT / "pyproject.toml", folder)
    for name, line in VIOLATIONS.values():
        with (folder / name).open("a") as file:
            file.write(f"\n{line}\n")
    result = subprocess.run(
        [sys.executable, "-c", LINT], cwd=folder, capture_output=True, text=True, check=False
    )
    assert result.returncode == 1
    _, found, listed = result.stdout.partition("Broken contracts\n")
    assert found, result.stdout
    headings = re.split(r"^(\w.*)\n-+\n", listed, flags=re.MULTILINE)
    return dict(zip(headings[1::2], headings[2::2], strict=True))


@pytest.mark.parametrize("contract", VIOLATIONS)
def test_a_violation_is_caught(reported, contract):
    """Each by its own contract, which names it."""
    path, line = VIOLATIONS[contract]
    module = path.removesuffix(".py").replace("/", ".")
    imported = line.removeprefix("import ")
    (text,) = (
        text for name, text in reported.items() if name.startswith(contract.partition(" (")[0])
    )
    assert f"- {module}\n" in text if not line else f"{module} -> {imported} (l." in text
