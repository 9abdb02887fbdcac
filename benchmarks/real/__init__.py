"""Recordings that others made of real sensors, which are not in the repository: each benchmark is
given their folder (`--data`)."""
