"""Selection of the effects that a scene needs, and the time cost of accuracy."""
