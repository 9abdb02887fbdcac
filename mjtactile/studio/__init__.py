"""A session watched live in MuJoCo Studio: the scene, what each finger sees and feels, and what can be done to it."""
