"""Test of equal forces for thin objects pressed into a membrane at random positions and speeds."""
