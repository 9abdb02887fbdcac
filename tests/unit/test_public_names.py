"""`import mjtactile` is the whole import: typed, lazy, and light."""

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import mjtactile

SOURCE = Path(mjtactile.__file__)


def imported_for_types():
    """Name to module, as a type checker reads them."""
    block = next(node for node in ast.parse(SOURCE.read_text()).body if isinstance(node, ast.If))
    return {alias.asname: (node.module, alias.name) for node in block.body for alias in node.names}


def test_type_checkers_and_users_get_the_same_names():
    assert sorted(imported_for_types()) == sorted(mjtactile.__all__)


@pytest.mark.parametrize("name", mjtactile.__all__)
def test_every_name_agrees_with_type_checkers_and_is_documented(name):
    value = getattr(mjtactile, name)
    assert imported_for_types()[name] == (value.__module__, name)
    assert inspect.getdoc(value)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="nonsense"):
        mjtactile.nonsense  # noqa: B018


def test_dir_lists_the_public_names():
    assert set(mjtactile.__all__) <= set(dir(mjtactile))


def run_python(code):
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout


def test_the_import_needs_only_the_standard_library():
    foreign = run_python("""
import sys
before = set(sys.modules)
import mjtactile
print(*{name.split(".")[0] for name in set(sys.modules) - before} - sys.stdlib_module_names - {"mjtactile"})
""")
    assert foreign.split() == []


def test_a_rig_without_a_simulator_needs_no_mujoco():
    loaded = run_python("""
import sys, mjtactile
for name in ("Finger", "Rig", "Session", "load_sensor", "Command", "build_rig"):
    getattr(mjtactile, name)
print("mujoco" in sys.modules)
""")
    assert loaded.strip() == "False"


def test_a_grasp_imports_no_scipy():
    """Importing scipy's linear algebra takes as long as numpy, MuJoCo and the package."""
    loaded = run_python("""
import sys
import mjtactile.commands.grasp, mjtactile.report.summary, mjtactile.sim.camera, mjtactile.runtime.grasp_scoring
print("scipy" in sys.modules)
""")
    assert loaded.strip() == "False"


def test_the_package_is_marked_as_typed():
    assert (SOURCE.parent / "py.typed").exists()


@pytest.mark.parametrize("name", sorted(mjtactile.__all__))
def test_help_has_no_long_default_values(name):
    """`help` prints the signature first; a line of the pages has 100 characters."""
    home = getattr(mjtactile, name)
    members = [home, *(vars(home).values() if inspect.isclass(home) else ())]
    for member in filter(callable, members):
        try:
            parameters = inspect.signature(member).parameters.values()
        except ValueError:  # a class of exceptions or a protocol
            continue
        long = [p.name for p in parameters if len(repr(p.default)) > 100]
        assert long == [], member
