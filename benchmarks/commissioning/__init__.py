"""`mjtactile bench commissioning`: results a new user obtains in an afternoon; see `run`."""
