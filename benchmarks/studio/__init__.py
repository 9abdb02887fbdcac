"""What watching costs: a grasp in Studio against the same grasp without it."""
