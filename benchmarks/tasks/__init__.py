"""Benefit of touch: tasks by controllers with touch, without touch, and with ground truth."""
