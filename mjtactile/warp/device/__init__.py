"""Warp functions and kernels: geometry, rubber, relaxation, contact, forces.

Type checkers skip this folder: Warp compiles these functions from their source, and its annotations
are values.
"""
