"""Drivers of real devices, and replay of a recording. Nothing here knows the simulator."""
