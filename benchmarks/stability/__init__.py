"""Hard cases of the simulation, each checked by physics."""
