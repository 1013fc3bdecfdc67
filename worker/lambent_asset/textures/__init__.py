"""Textures of the mesh, from the trained materials and from photographs."""
