"""Emulated hardware: a simulated grasp that looks like servos and valves on serial ports and
cameras on the network.

It runs in its own process and shares no code with the drivers that talk to it, but for the servos'
published tables.
"""
