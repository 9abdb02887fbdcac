"""What a rig is: small Protocols, rig files, and the builder that finds the backend of each."""
