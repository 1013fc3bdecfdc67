"""Scenes: rows, figures, and their REST routes."""
