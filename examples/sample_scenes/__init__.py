"""The scenes that `make_sample_scene.py` renders: shapes, paints and lights of our own.

Scene units, z up; everything lies inside a sphere of radius 1.3. Materials are Mitsuba's `principled` model:
GGX width alpha = perceptual_roughness^2, dielectric reflectance 0.04 at normal incidence.
"""
