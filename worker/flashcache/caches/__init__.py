"""Radiance caches: the environment far away, the NeRF cache, and the fast cache."""
