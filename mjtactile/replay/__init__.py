"""A recording as a rig."""
