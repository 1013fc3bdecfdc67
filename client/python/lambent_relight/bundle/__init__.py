"""The relightable bundle: files, checks, networks."""
