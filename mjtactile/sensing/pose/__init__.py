"""Ellipses to circles in space, and which marker each of them is."""
