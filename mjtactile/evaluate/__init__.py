"""Many grasps with many seeds: does a controller hold what it grasps, how often, and which of two
is better?"""
