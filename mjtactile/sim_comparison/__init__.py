"""A recording beside the simulator that is driven by the same commands."""
