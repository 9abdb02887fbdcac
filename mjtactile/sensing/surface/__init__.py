"""Circles to the membrane's surface."""
