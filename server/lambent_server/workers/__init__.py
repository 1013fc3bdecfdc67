"""The side of the server that run processes call, and what they may send."""
