"""Common base of all packages: values, errors, geometry, optics, sensor designs. It imports none of
the other packages."""
