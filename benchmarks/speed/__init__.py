"""Speed of the simulation, the sensing pipeline and the whole loop."""
