"""Known indenters on one simulated sensor: inflation, indentation, and the paper's own
experiments."""
