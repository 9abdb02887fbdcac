"""Known indenters on one simulated sensor: inflate, press, and the paper's own experiments."""
