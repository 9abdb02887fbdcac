"""Speed of the simulation, the sensing chain and the whole loop."""
