"""`mjtactile fabricate`: fabrication data from a sensor file.

Lengths in this package are mm, as in drawings, STEP and STL files. `Layout.of` and `Optics.of`
convert the design's SI values, once.
"""
