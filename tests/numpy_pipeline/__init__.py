"""Stages of the sensing chain in numpy, in their form before compilation: the reference for the
kernels."""
