"""The MuJoCo backend: the only place that imports mujoco. `mjtactile.sim.attach` is the front door."""
