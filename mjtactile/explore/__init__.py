"""Exploration of an unknown object by repeated touches until its surface is known.

See docs/how-to/explore.md.
"""
