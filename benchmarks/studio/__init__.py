"""Cost of Studio: a grasp shown in Studio against the same grasp without it."""
