"""Accuracy and speed of touch at the simulation levels for learning."""
