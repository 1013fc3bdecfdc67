"""The layers around every request: identity, limits, and error responses."""
