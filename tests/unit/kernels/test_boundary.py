"""Tests of the C boundary: invalid sizes, contents and settings are refused, and every return code
raises."""

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.kernels import bound, kernel
from mjtactile.kernels.bindings import declarations
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.pose import marker_matching
from mjtactile.sensing.settings import DEFAULTS

_DTYPES = {
    "double": float,
    "float": np.float32,
    "int64_t": np.int64,
    "int32_t": np.int32,
    "uint8_t": np.uint8,
}
ARRAYS = [
    (declaration.name, argument.name)
    for declaration in declarations().values()
    for argument in declaration.arguments
    if argument.shape
]


def values_of(declaration):
    """Return arrays of the declared sizes, with six for every integer."""
    values = [6 if argument.kind == "int64_t" else 1.0 for argument in declaration.arguments]
    sizes = declaration.sizes()(*values)
    return [
        np.zeros(size, _DTYPES[one.kind]) if one.shape else value
        for one, size, value in zip(declaration.arguments, sizes, values, strict=True)
    ]


@pytest.mark.parametrize(("name", "array"), ARRAYS)
def test_an_array_of_another_size_is_refused_by_name(name, array):
    declaration = declarations()[name]
    values = values_of(declaration)
    place = [argument.name for argument in declaration.arguments].index(array)
    valid = values[place]
    for wrong in (valid[:-1], np.zeros(len(valid) + 1, valid.dtype)):
        values[place] = wrong
        with pytest.raises(ValueError, match=f"{name}: {array}: shape .* needs {len(valid)}"):
            kernel(name)(*values)
        with pytest.raises((ValueError, TypeError), match=f"{name}: {array}"):
            bound(name, *values)


@pytest.mark.parametrize(("name", "array"), ARRAYS)
def test_only_optional_arguments_can_be_omitted(name, array):
    declaration = declarations()[name]
    values = values_of(declaration)
    place = [argument.name for argument in declaration.arguments].index(array)
    if declaration.arguments[place].optional:
        return
    values[place] = None
    with pytest.raises(TypeError, match=f"{name}: {array} is required"):
        kernel(name)(*values)


def test_a_size_may_depend_on_arguments_of_the_call():
    moved = np.zeros((2, 3))
    args = (..., moved, 1.0, 1.0, 1.0, 1.0, np.empty(2), np.empty(1), np.empty(2), np.empty((2, 3)))
    push = bound("apply_gas_load", 2, *args)
    push(np.ones((2, 3)))
    with pytest.raises(ValueError, match=r"apply_gas_load: gradient: shape .3, 3. has"):
        push(np.ones((3, 3)))
    with pytest.raises(TypeError, match="the size of moved is not known yet"):
        bound("apply_gas_load", ..., *args)


def test_indices_out_of_range_are_refused():
    p = np.zeros((3, 3))
    for triangles in ([[0, 1, 3]], [[0, -1, 2]]):
        with pytest.raises(ValueError, match="kernel chamber_volume: invalid arguments"):
            kernel("chamber_volume")(3, p, 1, triangles, np.empty((3, 3)), np.empty(1))
    out = np.empty((2, 2)), np.empty((2, 3)), np.empty(2), np.empty(2, np.int64)
    for counts in ([3, 4], [3, 2], [-1, 7], [2**62, 2**62]):
        with pytest.raises(ValueError, match="kernel border_moments"):
            kernel("border_moments")(2, counts, 6, np.zeros((6, 2), np.int32), 9, 9, *out)


def test_codes_raise_their_exceptions():
    band = np.full((1, 8), np.nan)
    with pytest.raises(np.linalg.LinAlgError, match="kernel factor_definite: a matrix is not fin"):
        kernel("factor_definite")(1, 0, band)
    # more than any computer has
    huge = 2**55
    with pytest.raises(MemoryError, match="kernel check_borders: no memory"):
        empty = np.broadcast_to(0.0, 0)
        library = kernel("check_borders").__self__
        library.function(huge, None, None, None, 1.0, np.zeros(29).ctypes.data, empty.ctypes.data)


def test_a_membrane_of_too_few_splines_is_refused():
    """With two intervals the kernel would write beyond its arrays."""
    design = load_sensor("dense")
    for spans in ((14, 2), (2, 10), (1, 1), (0, 10)):
        settings = DEFAULTS.inverse.__class__(spans=spans)
        with pytest.raises(InputError, match=r"inverse\.spans"):
            InverseMembrane(design, settings)
    coarse = InverseMembrane(design, DEFAULTS.inverse.__class__(spans=(3, 3)))
    assert np.isfinite(coarse.membrane.state(np.zeros((3, 16))).volume)


def test_neighbours_are_limited_to_the_available_markers():
    """The kernel matches all markers with any number of neighbours.

    More than 64 were refused before, and the unwritten output was used as marker numbers.
    """
    layout = load_sensor("dense").markers.p_SM
    found = layout + [2e-4, -1e-4, 0.0]
    for neighbours in (1, 8, 64, 65, 80, 500):
        s = DEFAULTS.identity.__class__(neighbours=neighbours)
        np.testing.assert_array_equal(
            marker_matching.match(found, layout, layout, s), np.arange(81)
        )
