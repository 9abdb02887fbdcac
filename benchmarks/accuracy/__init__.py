"""Work-precision diagrams of the simulation."""
