"""`mjtactile bench first_day`: what a stranger reaches in an afternoon; see `run`."""
