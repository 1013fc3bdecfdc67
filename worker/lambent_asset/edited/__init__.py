"""Export of a mesh that was edited in another program, with the materials and light transport of a bundle."""
