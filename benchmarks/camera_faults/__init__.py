"""Errors of estimated forces after changes of the camera."""
