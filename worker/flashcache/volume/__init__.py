"""Sampling along rays and the quadrature of the volume rendering equation."""
