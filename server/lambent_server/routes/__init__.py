"""The REST operations, one module for each kind of thing."""
