"""Stages of the sensing pipeline in numpy, in their form before compilation: the reference for the
kernels."""
