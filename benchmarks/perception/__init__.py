"""Markers and surface: accuracy and speed."""
