"""Hard cases of the simulation, each judged by physics."""
