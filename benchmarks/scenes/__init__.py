"""Worlds that only benchmarks and tests of physics need."""
