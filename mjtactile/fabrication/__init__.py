"""`mjtactile fabricate`: from a sensor file to what a bench needs. Lengths in this room are mm, as
in drawings, STEP and STL files; `Layout.of` and `Optics.of` convert the design's SI values,
once."""
