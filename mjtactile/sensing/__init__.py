"""Pixels to touch; a room a stage (image, pose, shape, force, touch), and `chain` where they
meet."""
