"""Recordings of runs: written so that a cut-off one can be read, read as columns and images."""
