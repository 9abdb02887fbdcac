"""Worlds with sensors in them: a gripper and an object, indenters, bodies of known material."""
