"""How fast the simulation, the sensing chain and the whole loop are."""
