"""Markers to the tractions that explain them: inverse membrane statics."""
