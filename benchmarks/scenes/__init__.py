"""Worlds for benchmarks and tests of physics."""
