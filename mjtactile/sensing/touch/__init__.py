"""Estimation of contact properties from tractions: patches, slip, material."""
