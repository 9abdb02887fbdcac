"""Evaluation over many grasps and seeds: success rate of a controller, and comparison of two."""
