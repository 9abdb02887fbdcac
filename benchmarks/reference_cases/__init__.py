"""Cases with a reference from outside of the project, each a TOML file."""
