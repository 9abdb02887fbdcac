"""Pixels to touch; a room a stage (image, pose, shape, force, touch), and `pipeline` where they
meet."""
