"""A mesh that somebody edited, put back: read, given maps and light transport, and written as a bundle."""
