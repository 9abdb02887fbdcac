"""Pixels to ellipses."""
