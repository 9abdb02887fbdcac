"""Emulated hardware: a simulated grasp behind the interfaces of real devices.

It appears as servos and valves on serial ports, and as cameras on the network. It runs in its own
process. It shares no code with the drivers, except the servos' published tables.
"""
