"""What everything rests on: values, errors, geometry, optics, sensor designs. Imports nothing of
the other rooms."""
