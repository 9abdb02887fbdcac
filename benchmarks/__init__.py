"""Benchmarks: they measure, and write data, tables and plots.

Besides scoring and tests, only they import ground truth.
"""
