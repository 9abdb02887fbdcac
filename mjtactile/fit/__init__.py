"""Identification of sensor parameters: the simulator is fitted to recordings of a sensor.

The result includes uncertainties and the parameters that the recordings cannot determine.
"""
