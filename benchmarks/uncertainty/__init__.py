"""Estimated wrenches and their uncertainty against ground truth, over random scenes."""
