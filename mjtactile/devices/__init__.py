"""Drivers of real devices, and replay of a recording. They do not depend on the simulator."""
