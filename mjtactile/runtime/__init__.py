"""A rig at work: the control loop, its supervisor, grasping and probing, the report."""
