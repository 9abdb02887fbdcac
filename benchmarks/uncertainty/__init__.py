"""Felt wrenches and their error bars against truth, over random scenes."""
