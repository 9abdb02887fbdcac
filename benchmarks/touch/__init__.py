"""Estimated touch against ground truth, on random indenters."""
