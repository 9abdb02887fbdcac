"""The import contracts hold, and each of them catches a violation (so none of them passes by being empty)."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]

VIOLATIONS = {
    "Layers": ("mjtactile/types.py", "import mjtactile.design"),
    "Layers (a new module without a place)": ("mjtactile/stray.py", ""),
    "Sensing meets": ("mjtactile/sensing/pose.py", "import mjtactile.rig"),
    "Only sim imports mujoco": ("mjtactile/control.py", "import mujoco"),
    "A controller sees": ("controllers/gentle.py", "import mjtactile.design"),
    "A controller sees (no simulator)": ("controllers/gentle.py", "import mujoco"),
    "Ground truth": ("mjtactile/control.py", "import mjtactile.sim.truth"),
}


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    folder = tmp_path_factory.mktemp("contracts")
    for name in ("mjtactile", "controllers"):
        shutil.copytree(CHECKOUT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
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
    return subprocess.run([sys.executable, "-c", LINT], cwd=folder, capture_output=True, text=True, check=False)


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
    broken = [text for text in result.stdout.splitlines() if text.endswith("BROKEN") or "BROKEN" in text]
    assert any(text.startswith(contract.split(" (")[0][:16]) for text in broken), result.stdout
