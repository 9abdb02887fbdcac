"""Benchmarks: measure, and write data, tables and plots. The only importers of ground truth besides
scoring and tests."""
