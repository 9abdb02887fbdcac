"""Calibrations: measured once for a sensor or a rig, kept with their residuals."""
