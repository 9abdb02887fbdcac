"""Worlds with sensors in them: gripper and object, indenters, objects of known material."""
