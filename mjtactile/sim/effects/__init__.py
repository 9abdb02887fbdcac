"""Which effects a scene calls for, and what accuracy costs in time."""
