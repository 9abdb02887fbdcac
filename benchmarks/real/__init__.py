"""Benchmarks on published recordings of real sensors.

The recordings are not in the repository; `--data` names their folder.
"""
