"""A mesh that a user edited in another program, given the materials and light transport of a bundle."""
