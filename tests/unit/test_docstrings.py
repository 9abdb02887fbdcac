"""Tests that the API page has a table of arguments for every public function.

Docstrings name each argument and field, the return value, and the exceptions, in the form that the
site reads.
"""

import dataclasses
import inspect
import re

import pytest

import mjtactile


def section(item, title):
    """Return the names in a section of a docstring, () without a section."""
    text = inspect.getdoc(item) or ""
    found = re.search(rf"(?ms)^{title}:\n(.*?)(?=^\S|\Z)", text)
    return set(re.findall(r"(?m)^    \*{0,2}(\w+):", found.group(1))) if found else ()


def plain(function):
    """Return a method's function."""
    return function.__func__ if isinstance(function, classmethod | staticmethod) else function


def functions():
    """Yield every public function, and every public method of public classes."""
    for name in mjtactile.__all__:
        item = getattr(mjtactile, name)
        if not inspect.isclass(item):
            yield name, item
            continue
        for key, value in vars(item).items():
            if not key.startswith("_") and inspect.isfunction(plain(value)):
                yield f"{name}.{key}", plain(value)


FUNCTIONS = dict(functions())
CLASSES = {
    name: getattr(mjtactile, name)
    for name in mjtactile.__all__
    if dataclasses.is_dataclass(getattr(mjtactile, name))
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_names_its_arguments_and_results(name):
    function = FUNCTIONS[name]
    signature = inspect.signature(function)
    assert set(signature.parameters) - {"self", "cls"} <= set(section(function, "Args"))
    text = inspect.getdoc(function)
    if signature.return_annotation not in (None, "None"):
        assert re.search(r"(?m)^(Returns|Yields):$", text)
    if re.search(r"(?m)^\s+raise [A-Z]", inspect.getsource(function)):
        assert section(function, "Raises")


@pytest.mark.parametrize("name", CLASSES)
def test_a_value_names_its_fields(name):
    kind = CLASSES[name]
    own = {field.name for field in dataclasses.fields(kind) if field.name in kind.__annotations__}
    assert {key for key in own if not key.startswith("_")} == set(section(kind, "Attributes")) & own
