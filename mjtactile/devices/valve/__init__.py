"""Valve boards on a serial port."""
