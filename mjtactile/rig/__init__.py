"""Rigs: device protocols, rig files, and the builder that selects the backend."""
