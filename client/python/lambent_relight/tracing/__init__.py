"""Exact rays against a triangle mesh: the first face that a ray meets."""
