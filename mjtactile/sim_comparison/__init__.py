"""Comparison of a recording with a simulation that is driven by the same commands."""
