"""Tractions to what touches: patches, slip, material."""
