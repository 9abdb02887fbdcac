"""The simulator fitted to recordings of a sensor: what it is made of, how sure that is, and what
the recordings cannot tell."""
