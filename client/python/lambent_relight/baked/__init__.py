"""Relighting from baked transport: no sampling, no noise."""
