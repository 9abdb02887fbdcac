"""`mjtactile bench commissioning`: what a stranger reaches in an afternoon; see `run`."""
