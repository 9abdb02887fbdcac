"""The MuJoCo backend. `attach` is its entry, `truth` is for scoring alone."""
